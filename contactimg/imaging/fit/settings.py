"""Constants that shape the result of the method "disk", with quantity, unit and origin.

A name ends in its unit: ``_PX``; ``_BLUR_WIDTHS``, standard deviations of the blurred edge; ``_SIGMA``,
standard uncertainties; ``_FRACTION``, of the contrast unless said otherwise; ``_RATIO``. Origins:

- *theory*: follows from the formula given.
- *false-alarm rate*: chosen for the probability given.
- *accuracy*: a numerical tolerance or bound, meant to be far below the uncertainty; sensitivity not measured.
- *by hand*: chosen by hand on rendered frames; sensitivity not measured.

The compiled iteration has numerical constants of its own (`contactimg.imaging.kernels`).
"""

# Image and noise (`method`, `problem`)
WIDEST_UNBINNED_BLUR_PX = 3.2
"""Frames with a wider blur are binned. Accuracy."""
BINNED_BLUR_PX = 1.6
"""Blur aimed at in binned pixels. Accuracy: that of the profile table."""
LEAST_NOISE_LEVELS = 1e-3
"""Smallest noise assumed, grey levels. Accuracy: keeps weights finite in a noise-free image."""
LEAST_NOISE_FRACTION = 5e-3
"""Smallest noise assumed. By hand: no contact is a perfect disk."""
DARKEST_RATIO = -0.95
"""Contrast over background level of the darkest contact. Theory: nothing is darker than black, -1."""
LEAST_LEVEL_FRACTION = 0.1
"""Smallest background level assumed when a contact's gain is computed. By hand."""

# One fit of all disks (`disks`)
RADIUS_TOLERANCE_SIGMA = 0.1
"""Error of a radius at which a disk has settled. Accuracy."""
LOOSE_CONTRAST_FRACTION = 0.1
"""Width of the contrast prior before the spread of the contrasts is measured. By hand."""
WIDE_RADIUS_BLUR_WIDTHS = 2.5
"""Wider contacts show their contrast. Theory: 1 - exp(-2.5^2/2) = 96 % of it at the centre."""
FEWEST_WIDE_DISKS = 3
"""Wide contacts needed to measure contrast and spread. By hand."""
ASSUMED_SPREAD_FRACTION = 0.03
"""Spread of the contrasts if fewer contacts are wide. By hand."""
BRIGHTEST_RATIO = 5.0
"""Largest contrast of a contact over the expected one. By hand."""
LEAST_SPREAD_FRACTION = 1e-4
"""Smallest spread of the contrasts. Accuracy: keeps the prior finite."""
CONTRAST_OUTLIER_SIGMA = 5.0
"""Robust standard deviations beyond which a contrast is an outlier. By hand."""

# Number of disks (`number_of_disks`, `significance`)
SIGNIFICANT_LIGHT_SIGMA = 5.0
"""Light below which a disk is dropped. False-alarm rate: 3e-7 for a normal deviate."""
FAINTEST_CONTRAST_FRACTION = 0.4
"""Contrast below which a disk is dropped. By hand."""
FAINTEST_SPREAD_SIGMA = 4.0
"""The same in standard deviations of the logarithm of the contrasts, where these scatter by more than a
fifth. False-alarm rate: 3e-5 for a normal deviate."""
SUSPICIOUS_CHI_SQUARE = 1.3
"""Mean chi-square of a disk above which another is searched beside it. By hand."""
SPECK_RADIUS_PX = 0.5
"""Radius below which a disk that touches another is dropped as part of its rim. By hand."""
LEAST_PEAK_FRACTION = 0.12
"""Height of a residual peak near a rim that becomes a disk. By hand: for imperfect rims."""
RIM_REACH_BLUR_WIDTHS = 5.0
"""Distance that counts as near a rim. By hand."""
SMOOTHED_CONTRAST_TO_NOISE = 12.0
"""Below, the image is smoothed before disks are inscribed. By hand: noise makes holes."""
INSCRIBED_GROWTH_RATIO = 1.3
"""Largest fitted over inscribed radius, besides one blur width. By hand."""
REPLACED_GROWTH_RATIO = 1.1
"""Largest fitted radius over that in a better cover. By hand."""
NEIGHBOUR_GAP_BLUR_WIDTHS = 3.0
"""Gap within which an added or dropped disk changes its neighbours. By hand."""

# Sharp rims (`coarse_rims`)
RIM_BAND = (0.2, 0.8)
"""Fractions of the contrast between which a pixel is at the rim. By hand."""
RIM_SAMPLE_PIXELS = 250_000
"""Pixels of an image that are looked at. Accuracy: a thousand at rims give their scatter to 4 %."""
RINGING_RATIO = 1.5
"""Noise beside contacts over that elsewhere from which the fit uses it. By hand."""
RINGING_REACH_PX = 12.0
"""Distance from a rim up to which the noise is then larger. By hand: JPEG works in blocks of 8 px."""
FEWEST_RIM_PIXELS = 10
"""Pixels at rims that give their scatter. By hand: half the rim of one contact of 2 px."""

# Work on a frame (`work`), in pixels times iterations of a fit
WORK_PER_PIXEL = 30.0
"""Work that a pixel of the frame may cost. Chosen: 1.2 s per megapixel at the 40 ns that
one unit takes; a frame of groups of two to five takes 2, a crowd that the light
is found in turn with more than 15."""
WORK_PER_SMALL_FRAME = 1e6
"""Work that any frame may cost. Chosen: 0.04 s."""
COVER_SHARE = 0.6
"""Share of it after which no more covers are tried. By hand."""
FIRST_STEP_RATIO = 1.5
"""Work over that limit beyond which not even one step of a fit is begun. Chosen: a crowd of which each step
takes a quarter of the limit ends at 1.35 times the limit, images without disks at many times."""
PASSES_AFTER_COVERS, PASSES_AFTER_HALO, PASSES_OF_ATTEMPT = 9, 10, 18
"""Iterations over all disks that are kept for what follows, and that another attempt takes. Chosen: contrast
and blur take ten in a frame of disks, a halo two times four; covers of touching beads need the rest."""
WORK_PER_FIT = 2e4
"""What a fit costs besides its pixels and disks. By hand; not measured."""

# Covers of badly fitted groups (`covers`, `group_window`)
GROUP_GAP_BLUR_WIDTHS = 2.0
"""Gap between rims within one group. By hand."""
LARGEST_GROUP = 20
"""Disks of the largest group for which covers are tried. By hand, for time."""
MOST_ARCS = 60
"""Arcs of the outline of a group at most. By hand: three a disk; more belong to no disks."""
BAD_FIT_RATIO = 1.3
"""Chi-square over its usual value above which a fit is bad, ... By hand."""
BAD_FIT_SIGMA = 6.0
"""... if it is so significant. False-alarm rate: 1e-9 for a normal deviate."""
LARGEST_USUAL_CHI_SQUARE = 2.0
"""Largest mean chi-square ascribed to the noise model. By hand."""
CHI_SQUARE_SLACK_SIGMA = 3.0
"""Excess chi-square that counts as none. False-alarm rate: 1e-3 for a normal deviate."""
DISK_PRICE = 40.0
"""Decrease of chi-square required for one more disk. Theory: 6^2 for 6 sigma, 4 for its parameters."""
EXCESS_LEFT_FRACTION = 0.35
"""Fraction of the excess chi-square that a new cover may leave. By hand."""
UNSETTLED_CHI_SQUARE_RATIO = 1.5
"""Chi-square over its expectation below which the same disks are refitted first. By hand."""
LEAST_GAIN = 1.0
"""Decrease of chi-square below which a cover of as many disks is the same one. Theory: one standard
uncertainty of one parameter."""
COVER_ROUNDS = 5
"""Rounds of trying covers at most. By hand."""
MISSING_DISK_PEAK_FRACTION = 0.3
"""Height of a residual peak at which a disk is added to those of an outline. By hand."""
ARC_GROWTH_RATIO = 1.1
"""Largest fitted radius of a disk over that of its arc, ... By hand."""
ARC_GROWTH_BLUR_WIDTHS = 0.3
"""... and an additional margin. By hand."""
NECK_LEVEL_FRACTION = 0.75
"""Level of a second outline, at which necks between touching contacts open. By hand."""
NECK_SHRINKAGE_BLUR_WIDTHS = 0.67
"""Distance of that outline from the rim. Theory: Phi(0.67) = 0.75."""
SMALLEST_ARC_BLUR_WIDTHS = 0.7
"""Smallest radius of an arc. By hand."""
GROUP_REACH_BLUR_WIDTHS = 4.0
"""Margin of the window about a group. Theory: a blurred edge is 3e-5 there."""
DISK_REACH_BLUR_WIDTHS = 2.0
"""Margin about a disk within which pixels count as its own. By hand."""
GROUP_ITERATIONS = 15
"""Gauss-Newton steps at most. Accuracy."""

# Common contrast and blur (`shared_optics`, `method`)
EXACT_FRACTION = 1e-4
"""Relative standard deviation of contrast or blur given as exact. Accuracy."""
OPTICS_STEPS = 20
"""Newton steps at most. Accuracy."""
LONGEST_CONTRAST_STEP = 0.4
"""Longest step of ln contrast. By hand."""
LONGEST_BLUR_STEP = 0.25
"""Longest step of the blur, relative to it. By hand."""
LINEAR_STEP = 0.003
"""Relative step below which disks are extrapolated linearly. Accuracy: the error is its square."""
FINE_TOLERANCE_SIGMA = 0.003
"""`RADIUS_TOLERANCE_SIGMA` of the fits between the steps. Accuracy."""
STEP_WORTH_SIGMA = 0.2
"""Change of the sum of a^3 below which no further fit is made. Accuracy."""
PLATEAU_STD_FRACTION = 0.02
"""Uncertainty of the plateau of wide contacts if edges are not those assumed. By hand."""
DISAGREEMENT_RATIO = 2.0
"""Variance over its expectation above which edges are not those assumed. By hand."""
FEWEST_SCORES = 10
"""Contacts needed to measure that variance. Theory: 20 deviates give it to a third, sqrt(2/20)."""
FULL_CONTRAST_RATIO = 0.9
"""Brightest light over the largest possible contrast from which spots show their contrast. By hand."""
LARGEST_CONTRAST_RATIO = 10.0
"""Largest contrast over brightest light, without prior knowledge. By hand."""
BLUR_GUESS_FRACTION = 0.5
"""Relative standard deviation of a guessed blur. By hand: right to a factor 2."""
MOST_ATTEMPTS = 3
"""Contrasts at which disks are detected, at most. By hand."""
CONTRAST_CHANGE_LOG = 0.1
"""Change of ln contrast after which disks are detected anew. By hand."""
LOST_DISKS_RATIO = 2
"""Factor by which the number of disks may shrink in that. By hand."""

# Flags and rejections (`quality`)
POOR_CHI_SQUARE = 1.5
"""Mean chi-square above which a contact has the flag POOR_FIT. By hand."""
LOW_SIGNAL_SIGMA = 10.0
"""Light below which a contact has the flag LOW_SIGNAL. By hand: twice the detection limit."""
LEAST_LIGHT_SIGMA = 2.0
"""Light below which a disk is left out of the result. By hand."""
EDGE_GAP_BLUR_WIDTHS = 2.0
"""Rims closer to the border have the flag EDGE. Theory: 98 % of the edge's light lies within."""
FEWEST_COMMON_CHI_SQUARE = 10
"""Contacts needed to ascribe their median chi-square to the noise model. By hand."""

# Halo (`halo`, `residual_light`)
HALO_WIDTHS_PX = (3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 24.0)
"""Standard deviations tried. By hand."""
HALO_BLOCK_PX = 2
"""Side of the block means on which halos are computed, a power of 2. Accuracy."""
CORE_END_FRACTION = 5e-4
"""Level below which only the halo is left. Accuracy."""
HALO_FALSE_ALARM = 3e-6
"""Probability of a halo in a frame without. False-alarm rate."""
LARGEST_HALO_FRACTION = 0.6
"""Largest halo, of the light. By hand: more would be the point spread function itself."""
LEAST_HALO_FRACTION = 0.01
"""Halo below which none is assumed, of the light. Accuracy."""
HALO_PARTS = 12
"""Parts of the image whose scatter gives the uncertainty, ... By hand."""
FEWEST_HALO_PARTS = 3
"""... at least, with one contact each. By hand."""
HALO_SETTLED_FRACTION = 2e-3
"""Change of the halo that ends the iteration, of the light. Accuracy."""
HALO_ROUNDS = 5
"""Rounds of halo and fit at most. By hand: each leaves about a fifth of the error."""
GIVEN_HALO_ROUNDS = 3
"""Rounds for a halo that is given. By hand."""

# Remaining illumination (`residual_light`)
UNTOUCHED_FRACTION = 1e-4
"""Light of contacts below which a block is background. Accuracy."""
LEAST_UNTOUCHED_SHARE = 0.05
"""Share of such blocks below which gaps between contacts are used instead. By hand."""
GAP_BLOCK_PX = 2
"""Side of the blocks then. By hand."""
GAP_SHARE = 0.05
"""Share of the blocks used then, those with the least light of contacts. By hand."""
LARGEST_GAP_FRACTION = 0.2
"""Light of contacts above which no block is used. By hand."""
FLAT_FRACTION = 3e-3
"""Remaining illumination that ends the iteration. Accuracy."""
ILLUMINATION_ROUNDS = 8
"""Rounds of illumination and fit at most. Accuracy."""
LONGEST_SECANT_RATIO = 4.0
"""Longest secant step over the remaining illumination. By hand."""
LARGEST_BACKGROUND_FRACTION = 0.5
"""Largest remaining illumination that is removed. By hand: more would remove contacts."""
LEAST_SCATTER_FRACTION = 1e-3
"""Smallest scatter of the blocks. Accuracy: below `FLAT_FRACTION`; an image without noise has none."""

# Frames of a series (`pooling`)
RESOLVED_CONTRAST_FRACTION = 0.1
"""Relative uncertainty up to which a frame's contrast is pooled. By hand: about normal."""
POOLING_OUTLIER_SIGMA = 5.0
"""Standard deviations beyond which a frame is an outlier. By hand."""
