"""What the disk method makes of a picture of touching beads that it was not made for."""

import cv2
import matplotlib.pyplot as plt
import pandas as pd
from imaging_figures import OTHERS, OURS, save
from imaging_scores import ROOT, markdown, put_table

from contactimg.imaging.measure import measure_image
from contactimg.pose.pairs import pair_points

DATA = ROOT / "tests" / "data"
NEAR = 14.0  # px: half the radius of the smallest bead


def show_beads(*, name="imaging_beads.png"):
    """Figure and table: beads found, beads missed, disks where no bead is."""
    seen = pd.read_csv(DATA / "beads_mono.csv")
    image = cv2.imread(str(DATA / "beads_mono.png"), cv2.IMREAD_GRAYSCALE)
    disks = measure_image(image, None, polarity="bright").disks
    found, true, _ = pair_points(disks[["x_px", "y_px"]], seen[["x_px", "y_px"]], max_distance=NEAR)
    missed, extra = seen.drop(index=seen.index[true]), disks.drop(index=disks.index[found])
    rows = [
        [kind, len(group), group.index.isin(seen.index[true]).sum()]
        for kind, group in seen.groupby("kind", sort=False)
    ]
    put_table(
        "beads", [*markdown(["beads", "seen", "found"], rows), "", f"Disks where no bead is: {len(extra)}."]
    )

    figure, axes = plt.subplots(figsize=(6.4, 4.84), layout="constrained")
    axes.imshow(image, cmap="gray")
    for group, colour in ((disks.iloc[found], OTHERS), (extra, OURS)):
        for disk in group.itertuples():
            axes.add_patch(
                plt.Circle((disk.x_px, disk.y_px), disk.radius_px, fill=False, color=colour, linewidth=1.6)
            )
    axes.plot(missed["x_px"], missed["y_px"], "x", color="#ffb703", markersize=10, markeredgewidth=2.5)
    axes.set(xlim=(-2, image.shape[1] + 1), ylim=(image.shape[0] + 1, -2))
    axes.set_axis_off()
    save(figure, name)
