"""Numbers that the steps of a measurement share: how far an edge reaches, what is significant, what fits.

Lengths in blur widths are standard deviations of the blurred edge, counted from the rim of a disk.
"""

NEAR_BLUR_WIDTHS = 2.0
"""About a rim. Theory: 98 % of the edge lies nearer; a disk so wide in radius shows 86 % of its contrast."""
EDGE_BLUR_WIDTHS = 3.0
"""Where an edge ends. Theory: 0.1 % of it is left."""
FIT_BLUR_WIDTHS = 3.6
"""From a rim to the pixels in a fit that it concerns. Theory: beyond, an edge is 0 or 1 to 2e-4."""
CLEAR_BLUR_WIDTHS = 4.0
"""From an edge to what it does not touch: background, another contact, or the middle of a contact so wide in
radius. Theory: 3e-5 of an edge is left."""
REACH_BLUR_WIDTHS = 5.0
"""Margin beyond a rim that nothing of it crosses; the mean height of a contact so wide in radius shows its
contrast. Theory: 3e-7 of the rim is left, and a blur wrong by a tenth changes that mean by 1 %."""

SETTLED_SIGMA = 0.2
"""Change, in its uncertainty, that needs no other fit. Accuracy: a coverage of 68 % is lowered by 1 %."""
SUSPICIOUS_CHI_SQUARE = 1.3
"""Mean squared residual over its variance above which other disks are tried. By hand."""
POOR_CHI_SQUARE = 1.5
"""The same above which a disk does not describe a contact. By hand."""
USUAL_CHI_SQUARE = 2.0
"""The largest one of a frame that is ascribed to its noise model. By hand."""

RESOLVED = 0.05
"""Relative standard uncertainty of the contrast above which a frame counts as not showing it. By hand: 2.5
% of the radius of a small contact and 7.5 % of its force."""
TWO_SIGNIFICANT = 30.0
"""Chi-square of two quantities that is not chance. False-alarm rate 3e-7: two degrees of freedom."""

FEWEST = 3
"""Values that give a scatter, and contacts that say something of a frame. Theory: two degrees of freedom."""
FEW = 10
"""Values that give a variance to a half, or a mean. Theory: sqrt(2/n)."""
ITERATIONS = 12
"""Newton or Gauss-Newton steps at most. Accuracy: four are usual."""
ROUNDS = 5
"""Rounds at most of a fit and what it assumes, in turn. Accuracy: each leaves about a fifth of the error."""
LONGEST_STEP = 0.25
"""Longest step of the blur, relative to it, of ln contrast, and of another parameter of the edge, relative to
its largest magnitude. Accuracy: keeps Newton steps finite."""

ROUGH_STD = 0.1
"""Relative standard uncertainty of what is known roughly. By hand."""
FAINT_FRACTION = 0.05
"""Light, of the contrast, of which a contact does not consist. By hand."""
LEAST_NOISE_FRACTION = 5e-3
"""Smallest noise assumed, of the contrast. By hand: no contact is a perfect disk."""
LEAST_FRACTION = 1e-3
"""Share of a level, a contrast or a number that makes no difference, and smallest spread assumed. Accuracy:
keeps weights finite, also in a constant image."""
NEGLIGIBLE_FRACTION = 1e-4
"""Relative change that no uncertainty is as small as. Accuracy."""

IMPERFECT_RIM = 0.12
"""Residual that an imperfect rim may leave, of the contrast: the root mean square about a round disk, which
is then not cut up, and the height of a peak near a rim, which then becomes no disk. By hand: three
disks in a triangle leave 0.17, an outline rough by 2 % of the radius 0.05."""
SHOWN_BLUR_WIDTHS = 3.0
"""Radius above which a contact shows its contrast, and half way between small and large ones. Theory: a
Gaussian spot of any contrast has 1.8 at half of its height, a disk of 3 has 99 % of it at the centre."""
SQUARE_PX = 2
"""Side of the squares whose means are looked at, px: they fit between crowded contacts. A power of 2."""
SMALL_AREA_PX2 = 4
"""Area below which a contact is flagged TOO_SMALL, and above which a region that is not round is a candidate.
By hand: four pixels make a radius of 1.1 px; less is noise, or left to the filter."""
NOISY_RATIO = 12.0
"""Contrast over noise below which noise notches outlines, and an image is smoothed before it is outlined.
Theory: twice six sigma."""
LONGEST_RADII = 1.6
"""Half the length of what is looked at as one contact, over the radius of its disk. Theory: 1.41 for an
ellipse of 2 : 1, and for two equal disks that touch."""
LEAST_VISIBLE = 0.2
"""Least share of a rim, or of a square, that is taken as seen. By hand."""
SAME_PLACE_RADII = 0.5
"""Distance between two disks, in radii, up to which they are the same contact. By hand."""
