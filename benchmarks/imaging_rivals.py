"""What the field would use to measure bright disks on a frame, each as a short function.

Every function takes the frame and its reference and returns x, y, radius (px), one row a contact. All but the
plain OpenCV one start from the same flat-fielded difference; those that need to know the blur are told the
true one. Parameters were chosen for the frames of the comparison, on other seeds than those compared.
"""

import cv2
import numpy as np
from imaging_bound import blurred_disk
from scipy import ndimage, optimize, spatial
from scipy.sparse import csgraph
from skimage import feature, measure, segmentation

BLUR = 1.4  # px, told to those who ask
WIDTH = float(np.hypot(BLUR, np.sqrt(1 / 12)))
LARGEST = 32.0  # px
NOISE = 3.3  # grey levels, of a pixel of the difference


# -- parts that several share


def flat_field(frame, reference):
    """Frame over reference, background 0, in grey levels of the background's median."""
    ratio = cv2.divide(frame, reference, scale=1.0, dtype=cv2.CV_32F)
    sample = ratio[::3, ::3]
    background = np.median(sample[sample < 1.3 * np.median(sample)])
    return (ratio / background - 1.0) * np.float32(np.median(reference[::3, ::3]))


def plateau_height(image):
    """Median brightness well inside the disks."""
    bright = (image > 0.5 * np.percentile(image[::2, ::2], 99.5)).astype(np.uint8)
    return float(np.median(image[cv2.erode(bright, np.ones((7, 7), np.uint8)) > 0]))


def disks_of(areas, centres):
    """Rows x, y, radius of circles of the same area; ``centres`` are row, column."""
    centres = np.asarray(centres).reshape(-1, 2)
    return np.column_stack([centres[:, 1], centres[:, 0], np.sqrt(np.asarray(areas) / np.pi)])


def split(mask):
    """Labels of a mask, touching disks separated by a watershed of the distance transform."""
    distance = ndimage.gaussian_filter(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5), 1.0)
    labels = measure.label(mask, connectivity=1)
    tops = feature.peak_local_max(distance, min_distance=2, labels=labels, exclude_border=False)
    markers = np.zeros(mask.shape, np.int32)
    markers[tuple(tops.T)] = np.arange(1, len(tops) + 1)
    return segmentation.watershed(-distance, markers, mask=mask)


def areas_and_centres(labels):
    regions = measure.regionprops(labels)
    return np.array([region.area for region in regions]), np.array([region.centroid for region in regions])


# -- pixel counts


def opencv_threshold(frame, reference):
    """Absolute difference, half height, connected components, radius from the area."""
    difference = cv2.absdiff(frame, reference)
    _, mask = cv2.threshold(difference, 0.5 * plateau_height(difference), 1, cv2.THRESH_BINARY)
    _, _, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=4)
    return disks_of(stats[1:, cv2.CC_STAT_AREA], centres[1:, ::-1])


def skimage_regions(frame, reference):
    """Half height, ``label``, ``regionprops``."""
    image = flat_field(frame, reference)
    labels = measure.label(image > 0.5 * plateau_height(image), connectivity=1)
    return disks_of(*areas_and_centres(labels))


def skimage_watershed(frame, reference):
    """The same with touching disks split by a watershed."""
    image = flat_field(frame, reference)
    return disks_of(*areas_and_centres(split(image > 0.5 * plateau_height(image))))


def area_lookup(frame, reference):
    """The same with the area corrected for the known blur: the radius whose image has that area."""
    counted = skimage_watershed(frame, reference)
    true = np.concatenate(
        [np.linspace(1.19, 4, 200) * WIDTH, np.linspace(4.1, 1.2 * LARGEST / WIDTH, 50) * WIDTH]
    )
    half = np.array([_half_height_radius(a) for a in true])
    counted[:, 2] = np.interp(counted[:, 2], half, true)
    return counted


def _half_height_radius(a):
    """Distance at which the blurred disk falls to half."""
    return optimize.brentq(lambda r: float(blurred_disk(np.array([r]), a, WIDTH)[0]) - 0.5, 0.0, a + WIDTH)


# -- brightness


def voronoi_intensity(frame, reference):
    """Brightness summed over each disk's Voronoi cell, out to where the blur ends."""
    image = flat_field(frame, reference)
    height = plateau_height(image)
    labels = split(image > 0.5 * height)
    distance, nearest = ndimage.distance_transform_edt(labels == 0, return_indices=True)
    cells = np.where(distance < 3.0 * BLUR, labels[tuple(nearest)], 0)
    index = np.arange(1, labels.max() + 1)
    light = ndimage.sum_labels(image, cells, index) / height
    return disks_of(np.maximum(light, 0.0), ndimage.center_of_mass(image, cells, index))


def sep_extract(frame, reference):
    """SEP (SExtractor): extraction at the noise with deblending, radius from the light."""
    import sep  # noqa: PLC0415

    image = flat_field(frame, reference)
    height = plateau_height(image)
    sep.set_sub_object_limit(4096)
    found = sep.extract(image, 1.0, err=NOISE, minarea=4, filter_kernel=None, deblend_cont=0.005, clean=False)
    found = found[found["flux"] > 3.0 * height]  # less than a pixel of radius is noise
    return disks_of(found["flux"] / height, np.column_stack([found["y"], found["x"]]))


def photutils_deblend(frame, reference):
    """Photutils: ``detect_sources`` and ``deblend_sources`` on the smoothed image, radius from the light."""
    from photutils import segmentation as sources  # noqa: PLC0415

    image = flat_field(frame, reference)
    smooth = cv2.GaussianBlur(image, (0, 0), BLUR)
    found = sources.detect_sources(smooth, 1.5 * NOISE, n_pixels=4)
    found = sources.deblend_sources(smooth, found, n_pixels=9, n_levels=32, contrast=0.02, progress_bar=False)
    catalogue = sources.SourceCatalog(image, found)
    light = np.maximum(catalogue.segment_flux, 0.0) / plateau_height(image)
    return disks_of(light, np.column_stack([catalogue.y_centroid, catalogue.x_centroid]))


def trackpy_locate(frame, reference):
    """Trackpy: ``locate``, made for particles of one size; radius from the radius of gyration."""
    import trackpy  # noqa: PLC0415

    image = np.maximum(flat_field(frame, reference), 0.0)
    found = trackpy.locate(image, diameter=61, minmass=300, separation=9, noise_size=BLUR, engine="numba")
    # a uniform disk's radius of gyration is a/sqrt(2)
    return np.column_stack([found["x"], found["y"], found["size"] * np.sqrt(2.0)])


# -- shapes


def opencv_hough(frame, reference):
    """``HoughCircles`` with gradients."""
    difference = cv2.absdiff(frame, reference)
    circles = cv2.HoughCircles(
        difference,
        cv2.HOUGH_GRADIENT_ALT,
        dp=1.0,
        minDist=3,
        param1=150,
        param2=0.6,
        minRadius=1,
        maxRadius=32,
    )
    return (
        np.empty((0, 3)) if circles is None else circles.reshape(-1, circles.shape[-1])[:, :3].astype(float)
    )


def opencv_blobs(frame, reference):
    """``SimpleBlobDetector``."""
    options = cv2.SimpleBlobDetector_Params()
    options.filterByColor, options.blobColor = True, 255
    options.minThreshold, options.maxThreshold, options.thresholdStep = 30, 80, 10
    options.filterByArea, options.minArea, options.maxArea = True, 3, 4000
    options.minDistBetweenBlobs, options.filterByInertia, options.filterByConvexity = 2, False, False
    found = cv2.SimpleBlobDetector_create(options).detect(cv2.absdiff(frame, reference))
    return np.array([(*point.pt, point.size / 2) for point in found]).reshape(-1, 3)


def laplacian_blobs(frame, reference):
    """scikit-image ``blob_log``: a disk is found at ``a = sqrt(2) sigma``."""
    return _blobs(feature.blob_log, frame, reference, num_sigma=24, log_scale=True)


def difference_blobs(frame, reference):
    """scikit-image ``blob_dog``."""
    return _blobs(feature.blob_dog, frame, reference, sigma_ratio=1.2)


def _blobs(find, frame, reference, **options):
    image = flat_field(frame, reference)
    found = find(
        image / plateau_height(image),
        min_sigma=1.2,
        max_sigma=LARGEST / np.sqrt(2),
        threshold=0.15,
        overlap=0.4,
        **options,
    )
    return np.column_stack([found[:, 1], found[:, 0], np.sqrt(2.0) * found[:, 2]])


# -- least squares


def scipy_least_squares(frame, reference):
    """Blurred disks fitted by ``scipy.optimize.least_squares``, those that share pixels together."""
    image = flat_field(frame, reference)
    height = plateau_height(image)
    start = disks_of(*areas_and_centres(split(image > 0.5 * height)))
    profile = _Profile()
    fitted = [_fit_group(image / height, start[group], profile) for group in _groups(start)]
    return np.concatenate(fitted)


def _groups(disks):
    """Indices of disks whose rims come closer than six blur widths."""
    pairs = [
        (i, j)
        for i, j in spatial.cKDTree(disks[:, :2]).query_pairs(2 * LARGEST + 6 * WIDTH)
        if np.hypot(*(disks[i, :2] - disks[j, :2])) < disks[i, 2] + disks[j, 2] + 6 * WIDTH
    ]
    matrix = np.zeros((len(disks), len(disks)), bool)
    matrix[tuple(np.array(pairs, int).reshape(-1, 2).T)] = True
    count, owner = csgraph.connected_components(matrix, directed=False)
    return [np.flatnonzero(owner == k) for k in range(count)]


class _Profile:
    """Blurred disk by linear interpolation in a table."""

    def __init__(self):
        self.radii, self.offsets = np.arange(0.3, 1.3 * LARGEST, 0.1), np.arange(-6 * WIDTH, 6 * WIDTH, 0.05)
        self.values = np.array([blurred_disk(np.abs(a + self.offsets), a, WIDTH) for a in self.radii])

    def __call__(self, r, a):
        place = np.clip((a - self.radii[0]) / 0.1, 0, len(self.radii) - 1.001)
        offset = np.clip((r - a - self.offsets[0]) / 0.05, 0, len(self.offsets) - 1.001)
        rows = self.values[int(place) : int(place) + 2]
        row = rows[0] + (place % 1) * (rows[1] - rows[0])
        column = offset.astype(int)
        return row[column] + (offset - column) * (row[column + 1] - row[column])


def _fit_group(image, disks, profile):
    reach = disks[:, 2:] + 4 * WIDTH
    low = np.maximum(np.floor((disks[:, :2] - reach).min(0)), 0).astype(int)
    high = np.ceil((disks[:, :2] + reach).max(0)).astype(int) + 1
    part = image[low[1] : high[1], low[0] : high[0]]
    y, x = np.mgrid[low[1] : low[1] + part.shape[0], low[0] : low[0] + part.shape[1]]

    def residual(parameters):
        model = sum(profile(np.hypot(x - cx, y - cy), a) for cx, cy, a in parameters.reshape(-1, 3))
        return (part - model).ravel()

    return optimize.least_squares(residual, disks.ravel(), method="lm", xtol=1e-5).x.reshape(-1, 3)
