"""What each figure shows, in full sentences: for the report and inside the files of the figures."""

CAPTIONS = {
    "area": "Real contact area A against load P, with the power law fitted to the measured points. The lower "
    "panel shows how far each point and each model lies from that law.",
    "profile": "Contact pressure against distance from the apex, relative to the Hertz contact of a smooth "
    "sphere at the same load.",
    "density": "Number of contacts per area against the local pressure, with the fitted power laws.",
    "mean_radius": "Mean contact radius against the local pressure, with the fitted power laws.",
    "friction": "Friction force Q against real contact area A, with the line of constant shear stress and "
    "its interval in grey. Squares are static forces, which the fit does not use; the lower panel "
    "shows what the line leaves over.",
    "topography": "Height of the asperities against their radius of curvature, with the line of a common "
    "contact angle where the data support one.",
    "jkr": "Contact radius of the smooth contact against load, with the fitted JKR law. The lower panel "
    "shows the measured minus the fitted load.",
    "slope_threshold": "Slope of the sum of the local forces against the load, for each threshold. The "
    "threshold is calibrated where the slope is 1; the dotted curve is the total contact area.",
    "forces": "Sum of the local forces against load, with the fitted slope. The lower panel shows the sum "
    "minus the load.",
    "plateau": "Total contact area of each frame against threshold, with the plateau shaded. The dotted "
    "curve shows how fast the total area falls; on the plateau it is slowest.",
    "check": "Contacts of known radius drawn into the frames and measured again. Above the share that is "
    "found, with its standard uncertainty; below measured minus true radius of each (dots), and their mean "
    "by radius with its standard uncertainty.",
    "tradeoff": "Relative error against computing time of the settings of each choice.",
}
"""Name of a figure, without number and ending -> caption."""


def caption_of(name: str) -> str:
    """The caption of a figure; empty if there is none.

    Examples
    --------
    >>> caption_of("profile_02") == CAPTIONS["profile"], caption_of("unknown")
    (True, '')
    """
    return CAPTIONS.get(name.rstrip("0123456789").removesuffix("_"), "")
