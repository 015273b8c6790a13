"""Schemas of the tables that describe asperities."""

from contactimg.tables.schemas import MESSAGE, Schema

ASPERITIES = Schema(
    "asperities",
    {
        "x_m": ("float64", "sample coordinate x of the summit, m"),
        "y_m": ("float64", "sample coordinate y of the summit, m"),
        "height_m": ("float64", "height of the summit above the base plane, m"),
        "radius_m": (
            "float64",
            "radius of curvature R of the summit, m; of an ellipsoidal cap that along its first axis",
        ),
        "radius_2_m": (
            "float64",
            "radius of curvature along the second axis, at right angles to the first, m; empty for a sphere",
        ),
        "azimuth_rad": (
            "float64",
            "direction of the first axis on the sample, from +x_m towards +y_m, rad; empty: along x",
        ),
        "young_modulus_Pa": (
            "float64",
            "Young's modulus of this asperity, Pa; empty: that of the scene, or rigid if it is on the lens",
        ),
    },
    "One row per asperity: a cap, spherical unless a second radius is given.",
    later=frozenset({"radius_2_m", "azimuth_rad", "young_modulus_Pa"}),
)

SUMMITS = Schema(
    "asperities",
    {
        **{name: ASPERITIES.columns[name] for name in ASPERITIES.first},
        "height_std_m": ("float64", "standard uncertainty of height_m, m"),
        "radius_std_m": ("float64", "standard uncertainty of radius_m, m"),
        "x_std_m": ("float64", "standard uncertainty of x_m, m"),
        "y_std_m": ("float64", "standard uncertainty of y_m, m"),
        "residual_m": ("float64", "standard deviation of the heights about the fitted sphere, m"),
        "pixels": ("Int64", "number of pixels that were fitted"),
        "message": MESSAGE,
    },
    "Summits of a height map from `asperities`, one row each; read wherever asperities are.",
)

TOPOGRAPHY = Schema(
    "topography",
    {
        "height_m": ("float64", "height h of an asperity, m"),
        "radius_m": ("float64", "radius of curvature R of the asperity, m"),
        "height_std_m": ("float64", "standard uncertainty of height_m, m"),
        "radius_std_m": ("float64", "standard uncertainty of radius_m, m"),
    },
    "Measured heights and radii of asperities, one row each.",
)
