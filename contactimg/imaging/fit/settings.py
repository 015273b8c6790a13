"""Constants that shape the result of the method "disk", with quantity, unit and origin.

A name ends in its unit: ``_PX``, ``_BLUR_WIDTHS`` (standard deviations of the blurred edge), ``_SIGMA``
(standard uncertainties), ``_FRACTION`` (of the contrast, unless said otherwise), ``_RATIO``. Origins:

- *theory*: follows from a formula, which is given.
- *false-alarm rate*: chosen for a probability, which is given.
- *accuracy*: a numerical tolerance or bound, meant to be far below the uncertainty; sensitivity not measured.
- *by hand*: chosen by hand on rendered frames; sensitivity not measured.

The compiled iteration has numerical constants of its own (`contactimg.imaging.kernels`).
"""

# Image and noise (`method`, `problem`)
WIDEST_UNBINNED_BLUR_PX = 3.2
"""Frames with a wider blur are binned; accuracy: the blur spans 2 pixels anyway."""
BINNED_BLUR_PX = 1.6
"""Blur aimed at in binned pixels; accuracy: a Gaussian sampled at 0.6 standard deviations."""
LEAST_NOISE_LEVELS = 1e-3
"""Smallest noise assumed, grey levels; accuracy: keeps weights finite without noise."""
LEAST_NOISE_FRACTION = 5e-3
"""Smallest noise assumed; by hand: smaller residuals are not credible."""
LEAST_LEVEL_FRACTION = 0.1
"""Smallest background level assumed for the contacts' gain; by hand."""

# One fit of all disks (`disks`)
RADIUS_TOLERANCE_SIGMA = 0.1
"""Remaining error of a radius at which it is left alone; accuracy."""
LOOSE_CONTRAST_FRACTION = 0.1
"""Width of the contrast prior until the frame shows its own spread; by hand."""
WIDE_RADIUS_BLUR_WIDTHS = 2.5
"""Contacts this wide show their contrast; theory: 1 - exp(-2.5^2/2) = 96 % of it."""
FEWEST_WIDE_DISKS = 3
"""Contacts that together determine the contrast; by hand."""
ASSUMED_SPREAD_FRACTION = 0.03
"""Spread of the contrasts if too few contacts are wide; by hand."""
LEAST_SPREAD_FRACTION = 1e-4
"""Smallest spread of the contrasts; accuracy: keeps the prior finite."""
CONTRAST_OUTLIER_SIGMA = 5.0
"""Robust deviations beyond which a contrast is left out; by hand."""

# Number of disks (`assemble`, `significance`)
SIGNIFICANT_LIGHT_SIGMA = 5.0
"""Light a contact must have; false-alarm rate 3e-7 of a normal deviate."""
FAINTEST_CONTRAST_FRACTION = 0.4
"""A fainter disk is no contact; by hand."""
SUSPICIOUS_CHI_SQUARE = 1.3
"""Of a disk beside which another is looked for again; by hand."""
SPECK_RADIUS_PX = 0.5
"""A disk smaller than a pixel that touches a contact describes its rim; by hand."""
LEAST_PEAK_FRACTION = 0.12
"""Residual peaks near a rim must be this high; by hand: imperfect rims stay below."""
RIM_REACH_BLUR_WIDTHS = 5.0
"""What is near a rim; by hand."""
SMOOTHED_CONTRAST_TO_NOISE = 12.0
"""Below, noise makes holes at half height: the image is smoothed; by hand."""
INSCRIBED_GROWTH_RATIO = 1.3
"""An inscribed disk that grows more takes in its neighbours; by hand."""
REPLACED_GROWTH_RATIO = 1.1
"""The same of a disk of a better cover, which was fitted before; by hand."""
NEIGHBOUR_GAP_BLUR_WIDTHS = 3.0
"""Gap between rims within which a new disk changes its neighbour; by hand."""
PEAK_ROUNDS = 4
"""Rounds of adding disks at most; by hand."""

# Covers of badly fitted groups (`covers`, `group_window`)
GROUP_GAP_BLUR_WIDTHS = 2.0
"""Gap between rims within one group; by hand."""
LARGEST_GROUP = 20
"""Disks; a larger group is left as it is, for time; by hand."""
BAD_FIT_RATIO = 1.3
"""Chi-square over the usual one that calls for another cover; by hand."""
BAD_FIT_SIGMA = 6.0
"""Its significance; false-alarm rate 1e-9 of a normal deviate."""
LARGEST_USUAL_CHI_SQUARE = 2.0
"""Mean chi-square that the noise model may be wrong by; by hand."""
CHI_SQUARE_SLACK_SIGMA = 3.0
"""Excess chi-square within its scatter is explained; false-alarm rate 1e-3."""
DISK_PRICE = 40.0
"""Decrease of chi-square one more disk must bring; theory: 6^2 for 6 sigma, 4 for its parameters."""
EXCESS_LEFT_FRACTION = 0.35
"""Of the excess chi-square that a new cover may leave; by hand."""
UNSETTLED_CHI_SQUARE_RATIO = 1.5
"""Up to it the same disks are first fitted again; by hand."""
COVER_ROUNDS = 5
"""Rounds of trying covers at most; by hand."""
MISSING_DISK_PEAK_FRACTION = 0.3
"""Residual peak that calls for one more disk along an outline; by hand."""
ARC_GROWTH_RATIO, ARC_GROWTH_BLUR_WIDTHS = 1.1, 0.3
"""What a disk that follows an arc may grow; by hand."""
NECK_LEVEL_FRACTION = 0.75
"""Level at which necks between touching contacts open; by hand."""
NECK_SHRINKAGE_BLUR_WIDTHS = 0.67
"""By which rims retreat there; theory: Phi(0.67) = 0.75."""
SMALLEST_ARC_BLUR_WIDTHS = 0.7
"""Radius below which no arc shows; by hand."""
GROUP_REACH_BLUR_WIDTHS = 4.0
"""Margin of a group's window; theory: a blurred edge has ended at 4 (3e-5)."""
DISK_REACH_BLUR_WIDTHS = 2.0
"""Pixels about a disk that count as its own; by hand."""
GROUP_ITERATIONS = 15
"""Gauss-Newton steps at most; accuracy."""

# Common contrast and blur (`shared_optics`)
EXACT_FRACTION = 1e-4
"""Relative standard deviation of a prior that is said to be exact; accuracy."""
OPTICS_STEPS = 20
"""Newton steps at most; accuracy."""
LONGEST_CONTRAST_STEP, LONGEST_BLUR_STEP = 0.4, 0.25
"""Of ln contrast, and relative; by hand: steps stay safe."""
LINEAR_STEP = 0.003
"""Relative step up to which disks follow in proportion; accuracy: the error is its square."""
FINE_TOLERANCE_SIGMA = 0.003
"""As RADIUS_TOLERANCE_SIGMA, of fits that say how the optics change; accuracy."""
STEP_WORTH_SIGMA = 0.2
"""Of the sum of a^3: a smaller step is not worth another fit; accuracy."""
PLATEAU_STD_FRACTION = 0.02
"""Uncertainty of the plateau of wide contacts with other edges than assumed; by hand."""
DISAGREEMENT_RATIO = 2.0
"""Scatter over expected variance from which edges are not those assumed; by hand."""
FEWEST_SCORES = 10
"""Contacts whose scatter is believed; by hand: its variance is then known to a third."""
LARGEST_CONTRAST_RATIO = 10.0
"""Contrast over brightest light without prior; by hand: smaller disks vanish."""
BLUR_GUESS_FRACTION = 0.5
"""Relative standard deviation of a guessed blur; by hand: right to a factor 2."""
MOST_ATTEMPTS = 3
"""Times that disks are detected anew at another contrast; by hand."""
CONTRAST_CHANGE_LOG = 0.1
"""Change of ln contrast that calls for it; by hand."""
LOST_DISKS_RATIO = 2
"""An attempt with fewer than 1/2 of the disks is refused; by hand."""
FILM_BLUR_RATIO, FILM_BLUR_STEPS = (
    1.1,
    5,
)  # blurs tried about the guess with a film; by hand: covers 0.6 to 1.6

# Quality (`method`)
POOR_CHI_SQUARE = 1.5
"""Flag POOR_FIT above; by hand."""
LOW_SIGNAL_SIGMA = 10.0
"""Light, flag LOW_SIGNAL below; by hand: twice SIGNIFICANT_LIGHT_SIGMA."""
LEAST_LIGHT_SIGMA = 2.0
"""Light below which a disk is dropped in the end; by hand."""
EDGE_GAP_BLUR_WIDTHS = 2.0
"""Rims this close to the border are cut, flag EDGE; theory: 2 sigma of the edge."""
FEWEST_COMMON_CHI_SQUARE = 10
"""Contacts whose median chi-square is a property of the frame; by hand."""

# Halo (`halo`, `residual_light`)
HALO_WIDTHS_PX = (3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 24.0)
"""Standard deviations tried; by hand."""
HALO_BLOCK_PX = 2
"""Side of the block means on which halos are computed; accuracy: halos are smooth."""
CORE_END_FRACTION = 5e-4
"""The core of the point spread function has ended below; accuracy."""
HALO_FALSE_ALARM = 3e-6
"""Probability of finding a halo where there is none; false-alarm rate."""
LARGEST_HALO_FRACTION = 0.6
"""Of the light; by hand: more is not a halo but the point spread function itself."""
LEAST_HALO_FRACTION = 0.01
"""Of the light; accuracy: changes no radius by more than its error."""
HALO_PARTS, FEWEST_HALO_PARTS = 12, 3
"""Parts of the image whose scatter gives the uncertainty; by hand."""
HALO_SETTLED_FRACTION = 2e-3
"""Of the light: change that ends the iteration; accuracy."""
HALO_ROUNDS = 5
"""Rounds of halo and fit; theory: a round leaves a fifth of the error."""
GIVEN_HALO_ROUNDS = 3
"""The same of a halo that is given; by hand."""

# Remaining illumination (`residual_light`)
UNTOUCHED_FRACTION = 1e-4
"""Blocks that contacts brighten by less are background; accuracy."""
LEAST_UNTOUCHED_SHARE = 0.05
"""Of all blocks that must be background; by hand."""
GAP_BLOCK_PX = 2
"""Side of the blocks looked at where they are fewer; by hand: gaps of a crowd."""
GAP_SHARE, LARGEST_GAP_FRACTION = 0.05, 0.2
"""Then the least brightened 5 %, if by less than this; by hand."""
FLAT_FRACTION = 3e-3
"""Remaining illumination that no fit responds to; accuracy."""
ILLUMINATION_ROUNDS = 8
"""Rounds of illumination and fit; accuracy."""
LONGEST_SECANT_RATIO = 4.0
"""Secant step over the remainder; by hand: steps stay safe."""
LARGEST_BACKGROUND_FRACTION = 0.5
"""A background that rises by more would swallow the contacts; by hand."""
LEAST_SCATTER_LEVELS = 1e-3
"""Smallest scatter of the blocks, grey levels; accuracy: keeps the fit finite."""

# Frames of a series (`pooling`)
RESOLVED_CONTRAST_FRACTION = 0.1
"""Relative uncertainty of a contrast that may be pooled; by hand: about normal."""
POOLING_OUTLIER_SIGMA = 5.0
"""A frame further off does not count; by hand."""
