"""What each figure shows, in full sentences: for the report and inside the files of the figures."""

BARS = "Error bars: one standard uncertainty (68 %)"
NO_BARS = "Points have no error bars."

CAPTIONS = {
    "area": "Real contact area A against load P, with the power law fitted to the measured points. The lower "
    f"panel shows how far each point and each model lies from that law. {BARS} of area and load; in an "
    "analysis that of the area contains what other places of the surface would show.",
    "profile": "Contact pressure against distance from the apex, relative to the Hertz contact of a smooth "
    f"sphere at the same load. {BARS} of the measured pressure; models have none.",
    "density": "Number of contacts per area against the local pressure, with the fitted power laws. "
    f"{BARS} of the measured density; models have none.",
    "mean_radius": "Mean contact radius against the local pressure, with the fitted power laws. "
    f"{BARS} of the measured mean; models have none.",
    "friction": "Friction force Q against real contact area A, with the line of constant shear stress and "
    "its interval in grey. Squares are static forces, which the fit does not use; the lower panel "
    f"shows what the line leaves over. {BARS} of the area.",
    "sheared_areas": "Area of each contact against the tangential load Q; the colour is its largest radius, "
    f"and a line joins the frames of one contact at one normal load. {NO_BARS}",
    "jkr": "Contact radius of the smooth contact against load, with the fitted JKR law. The lower panel "
    f"shows the measured minus the fitted load. {NO_BARS}",
    "slope_threshold": "Slope of the sum of the local forces against the load, for each threshold. The "
    "threshold is calibrated where the slope is 1. The "
    "band is one standard uncertainty (68 %) of the slope to either side.",
    "forces": "Sum of the local forces against load, with the fitted slope. The lower panel shows the sum "
    f"minus the load. {NO_BARS}",
    "plateau": "Total contact area of each frame against threshold, with the plateau shaded, on which "
    f"the total area falls slowest. {NO_BARS}",
    "law": "Real contact area against load: the wanted law, and those of the surfaces designed for it as if "
    "contacts were independent and with contacts that displace each other. The lower panel shows how far "
    "each lies from the wanted law. The band is one standard uncertainty from errors of the heights.",
    "check": "Contacts of known radius drawn into the frames and measured again. Above the share that is "
    "found, below measured minus true radius of each (dots), their mean by radius, and as error bars their "
    "root mean square.",
    "tradeoff": "Relative error against computing time of the settings of each choice. The star is the "
    f"fastest one below the tolerance. {NO_BARS}",
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
