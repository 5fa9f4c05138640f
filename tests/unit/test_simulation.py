from math import inf, nan

import numpy as np
import pytest
from inputs import refused
from scipy.spatial import ConvexHull, cKDTree

from mexpress import simulation
from mexpress.simulation import Camera, Configuration, Setting, Sheet, correspondences, scene, sheets
from mexpress.simulation.cameras import IMAGE_SIZE
from mexpress.simulation.developable import _sheets
from mexpress.simulation.pairs import views
from mexpress.simulation.poses import is_simple, random_camera, visible

SOME = simulation.configurations()[::37]
GRID = (34, 60)


def ends(sheet, ruling):
    """Where a ruling meets the sheet's bounding box, in the sheet's coordinates."""
    cosine, sine = np.cos(sheet.turn), np.sin(sheet.turn)
    half = (abs(sine) * sheet.width + abs(cosine) * sheet.height) / 2
    along = np.array([sheet.lower[ruling], sheet.upper[ruling]])[:, None] * [cosine, sine]
    return along + np.array([[-half], [half]]) * [-sine, cosine]


def on_sheet(sheet, points):
    return points[(np.abs(points) <= (sheet.width / 2, sheet.height / 2)).all(axis=1)]


def length(points):
    return np.linalg.norm(np.diff(points, axis=0), axis=1).sum()


@pytest.mark.slow
@pytest.mark.parametrize("index", range(10))
def test_lengths_on_a_sheet_are_kept(index):
    sheet, rng = sheets()[index], np.random.default_rng(index)
    time = np.linspace(0, 2 * np.pi, 20000)[:, None]
    for _ in range(5):
        curve = sum(rng.normal(size=2) * np.sin(k * time + rng.uniform(0, 6, 2)) / k for k in (1, 2, 3))
        curve *= (0.8, 0.45) / np.abs(curve).max(axis=0)
        assert length(sheet(curve)) == pytest.approx(length(curve), rel=1e-5)
    # Chords are shorter, for a sheet that is bent.
    chords = rng.uniform(-0.5, 0.5, (100, 2, 2)) * (1.6, 0.9)
    shares = [length(sheet(chord)) / length(chord) for chord in chords]
    assert max(shares) <= 1 + 1e-12
    assert min(shares) < 0.99


@pytest.mark.parametrize("index", range(10))
def test_rulings_stay_straight(index):
    sheet = sheets()[index]
    checked = 0
    for ruling in range(0, len(sheet.angles), 7):
        a, b = ends(sheet, ruling)
        flat = on_sheet(sheet, a + np.linspace(0, 1, 200)[:, None] * (b - a))
        if len(flat) < 3:
            continue
        bent = sheet(flat)
        assert np.linalg.norm(bent[-1] - bent[0]) == pytest.approx(
            np.linalg.norm(flat[-1] - flat[0]), rel=1e-12
        )
        np.testing.assert_allclose(np.diff(bent, 2, axis=0), 0, atol=1e-12)
        checked += 1
    assert checked > 20


@pytest.mark.parametrize("index", range(10))
def test_the_curvature_of_gauss_vanishes(index):
    sheet, step = sheets()[index], 0.02
    middle = sheet.grid(20, 12) * 0.9
    shifted = {(i, j): sheet(middle + step * np.array([i, j])) for i in (-1, 0, 1) for j in (-1, 0, 1)}
    normal = sheet.normals(middle)
    second = [
        shifted[1, 0] - 2 * shifted[0, 0] + shifted[-1, 0],
        shifted[0, 1] - 2 * shifted[0, 0] + shifted[0, -1],
        (shifted[1, 1] - shifted[1, -1] - shifted[-1, 1] + shifted[-1, -1]) / 4,
    ]
    along_x, along_y, mixed = ((part * normal).sum(axis=1) / step**2 for part in second)
    bending = np.abs(along_x + along_y).max()
    assert bending > 0.3
    assert np.abs(along_x * along_y - mixed**2).max() < 0.02 * bending**2


@pytest.mark.parametrize("seed", [0, 1])
def test_rulings_do_not_cross_in_the_sheet(seed):
    for sheet in sheets(seed):
        for share in np.linspace(0, 1, 11):
            assert (np.diff((1 - share) * sheet.lower + share * sheet.upper) > 0).all()


def test_a_fold_is_seen_from_the_side():
    sheet = Sheet([-0.5, 0.5], [-0.5, 0.5], [np.pi / 2, np.pi / 2], width=3, height=1)
    a, b = sheet([[-1.5, 0], [1.5, 0]])
    assert np.linalg.norm(b - a) == pytest.approx(1)  # three sides of a square
    assert sheet.bend == pytest.approx(np.pi)


def test_an_unfolded_sheet_is_flat():
    sheet = Sheet([0.0], [0.3], [0.0], turn=0.4)
    where = sheet.grid(7, 5)
    np.testing.assert_allclose(sheet(where), np.column_stack([where, np.zeros(35)]), atol=1e-12)
    np.testing.assert_allclose(sheet.normals(where), np.tile([0, 0, 1], (35, 1)), atol=1e-12)


def test_a_fold_is_where_it_was_asked_for():
    sheet = Sheet([0.2], [0.2], [0.5], turn=np.pi / 2, width=1, height=1)  # horizontal, at y = 0.2
    points = [[0.3, 0.19], [-0.3, -0.4], [0.3, 0.21], [-0.1, 0.5]]
    normals = sheet.normals(points)
    np.testing.assert_allclose(normals[0], normals[1])
    np.testing.assert_allclose(normals[2], normals[3])
    assert np.arccos(normals[0] @ normals[2]) == pytest.approx(0.5)


def test_a_camera_projects():
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    camera = Camera(17.5, turn, [0.1, 0, 1])
    # 960 pixels of focal length; (1, 0, 1) is turned to (0, 1, 1), and is then at (0.1, 1, 2).
    np.testing.assert_allclose(camera([[1, 0, 1]]), [[960 + 48, 540 + 480]])
    affine = Camera(17.5, turn, [0.1, 0, 1], affine=True)
    np.testing.assert_allclose(affine([[1, 0, 1]]), [[960 + 96, 540 + 960]])


def test_sheets_fill_the_view():
    shares = []
    for configuration in SOME:
        matches = correspondences(configuration, 500, noise=0)
        for found in (matches.source, matches.target, matches.dense_source, matches.dense_target):
            assert (found >= 0).all()
            assert (found <= IMAGE_SIZE).all()
        # The sheet itself covers more: these are the points that are in the other view too.
        shares.append(ConvexHull(matches.source).volume / np.prod(IMAGE_SIZE))
    assert min(shares) > 0.5
    assert np.mean(shares) > 0.8


@pytest.mark.parametrize("configuration", SOME)
def test_no_part_of_a_sheet_hides_another(configuration):
    for sheet, camera in views(configuration, 0):
        place = sheet.grid(GRID[1], GRID[0])
        x, y = camera(sheet(place)).T.reshape(2, *GRID)
        for corner in ((0, 0), (0, 1), (1, 0), (1, 1)):
            assert (_turns(x, y, *corner) > 0).all()
        pairs = cKDTree(np.column_stack([x.ravel(), y.ravel()])).query_pairs(6.0, output_type="ndarray")
        apart = np.linalg.norm(place[pairs[:, 0]] - place[pairs[:, 1]], axis=1)
        assert apart.max(initial=0) < 0.12


def _turns(x, y, row, column):
    """Twice the areas of the triangles at one corner of every cell of a grid."""
    rows, columns = (slice(row, row - 1 or None) for row in (row, column))
    across = (slice(1 - row, -row or None), columns), (rows, slice(1 - column, -column or None))
    (down_x, right_x), (down_y, right_y) = (
        [grid[other] - grid[rows, columns] for other in across] for grid in (x, y)
    )
    sign = (1 if row == 0 else -1) * (1 if column == 0 else -1)
    return sign * (right_x * down_y - right_y * down_x)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("focal", [20.0, 50.0])
def test_every_sheet_can_be_seen(seed, focal):
    rng = np.random.default_rng(seed)
    for sheet in sheets(seed):
        assert visible(sheet, random_camera(sheet, focal, rng))


def test_a_rolled_sheet_is_not_seen_whole():
    rulings = np.linspace(-0.7, 0.7, 100)
    rolled = Sheet(rulings, rulings, np.full(100, 2 * np.pi / 100))
    assert not visible(rolled, random_camera(rolled, 30.0, np.random.default_rng(0)))


def test_a_figure_of_eight_crosses_itself():
    angle = np.linspace(0, 2 * np.pi, 50, endpoint=False)
    assert is_simple(np.column_stack([np.cos(angle), np.sin(angle)]))
    assert not is_simple(np.column_stack([np.cos(angle + 0.01), np.sin(2 * angle + 0.02)]))


def test_there_are_450_different_configurations():
    every = simulation.configurations()
    assert len(every) == len(set(every)) == 450
    assert every == simulation.configurations()
    assert {(c.source, c.target) for c in every} == {(i, j) for i in range(10) for j in range(10) if i != j}


@pytest.mark.slow
def test_noise_is_independent_in_every_coordinate_of_both_images():
    configuration, n = Configuration(2, 5, 3), 20000
    noisy, clean = (correspondences(configuration, n, noise=noise) for noise in (1.0, 0.0))
    noise = np.hstack([noisy.source - clean.source, noisy.target - clean.target])
    np.testing.assert_allclose(noise.T @ noise / n, np.eye(4), atol=0.04)
    np.testing.assert_allclose(noise.mean(axis=0), 0, atol=0.03)
    np.testing.assert_array_equal(noisy.dense_target, clean.dense_target)
    twice = correspondences(configuration, n, noise=2.0)
    np.testing.assert_allclose(twice.source - clean.source, 2 * noise[:, :2], atol=1e-9)


@pytest.mark.slow
def test_points_are_uniform_in_the_source_image():
    matches = correspondences(Configuration(0, 1, 0), 20000, noise=0)
    # Squares of 120 pixels that lie well inside the sheet's image have about as many points each.
    tree = cKDTree(matches.dense_source)
    corners = np.stack(np.meshgrid(np.arange(0, 1920, 120), np.arange(0, 1080, 120)), axis=-1).reshape(-1, 2)
    edges = [corners + 120 * np.array(shift) for shift in ((0, 0), (0, 1), (1, 0), (1, 1))]
    inside = np.all([tree.query(edge)[0] < 25 for edge in edges], axis=0)
    cells = (matches.source // 120).astype(int)
    counts = np.array([(cells == corner // 120).all(axis=1).sum() for corner in corners[inside]])
    assert len(counts) > 20
    assert (np.abs(counts - counts.mean()) < 5 * np.sqrt(counts.mean())).all()
    # The same points in both images: each is near the images of the nearest grid point.
    _, nearest = tree.query(matches.source)
    assert np.linalg.norm(matches.dense_target[nearest] - matches.target, axis=1).max() < 100


def arrays(matches):
    return [matches.source, matches.target, matches.dense_source, matches.dense_target]


def test_a_configuration_does_not_depend_on_what_came_before():
    whole = {c: correspondences(c, 15) for c in SOME}
    _sheets.cache_clear()
    views.cache_clear()
    for configuration in reversed(SOME):
        alone = correspondences(
            Configuration(configuration.source, configuration.target, configuration.view), 15
        )
        for a, b in zip(arrays(whole[configuration]), arrays(alone), strict=True):
            np.testing.assert_array_equal(a, b)


def test_without_a_setting_sheets_and_views_are_what_they_were():
    for configuration in SOME[:3]:
        whole, again = (
            arrays(correspondences(configuration, 15, setting=setting)) for setting in (Setting(), Setting(8))
        )
        plain = arrays(correspondences(configuration, 15))
        for a, b, c in zip(whole, again, plain, strict=True):
            np.testing.assert_array_equal(a, b)
            np.testing.assert_array_equal(a, c)


def test_fewer_waves_bend_a_sheet_less_often():
    turns = [
        np.mean([np.count_nonzero(np.diff(np.sign(sheet.angles))) for sheet in sheets(0, setting)])
        for setting in (
            Setting(waves=2, decay=0.0),
            Setting(waves=8, decay=0.0),
            Setting(waves=8, decay=-2.0),
        )
    ]
    assert turns == sorted(turns)
    assert turns[0] < turns[1] < turns[2]


def test_views_are_tilted_and_near_as_the_setting_has_them():
    def seen(**setting):
        given = Setting(**setting)
        every = [view for c in SOME for view in views(c, 0, given)]
        directions = [np.arccos(camera.rotation[2, 2]) for _, camera in every]
        return np.array(directions), np.array([camera.translation[2] / camera.focal for _, camera in every])

    frontal, _ = seen(tilt=(0.0, 0.0))
    np.testing.assert_allclose(frontal, 0, atol=1e-7)
    tilted, far = seen(tilt=(0.3, 0.2), fill=1.0)
    assert tilted.max() <= 0.3 + 1e-9
    assert np.median(tilted) >= 0.2
    _, near = seen(tilt=(0.3, 0.2), fill=1.5)
    assert np.mean(near) < 0.8 * np.mean(far)


def test_everything_else_differs():
    first = arrays(correspondences(Configuration(1, 2, 0), 15))
    others = {
        "seed": correspondences(Configuration(1, 2, 0), 15, seed=1),
        "view": correspondences(Configuration(1, 2, 1), 15),
        "order": correspondences(Configuration(2, 1, 0), 15),
        "setting": correspondences(Configuration(1, 2, 0), 15, setting=Setting(waves=7)),
    }
    for other in map(arrays, others.values()):
        for a, b in zip(first, other, strict=True):
            assert a.shape != b.shape or np.abs(a - b).max() > 5


def test_only_the_points_depend_on_their_number():
    few, many = (correspondences(Configuration(1, 2, 0), n) for n in (15, 30))
    np.testing.assert_array_equal(few.dense_source, many.dense_source)
    np.testing.assert_array_equal(few.dense_target, many.dense_target)
    assert np.abs(few.source - many.source[:15]).max() > 5


def homography_rows(source, target):
    """Direct linear equations of a homography, in coordinates of the order of one."""
    (x, y), (u, v) = source.T / 1000, target.T / 1000
    zero, one = np.zeros_like(x), np.ones_like(x)
    return np.concatenate(
        [
            np.column_stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u]),
            np.column_stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v]),
        ]
    )


def epipolar_rows(source, target):
    """Equations of a fundamental matrix, in coordinates of the order of one."""
    one = np.ones((len(source), 1))
    a, b = np.hstack([source / 1000, one]), np.hstack([target / 1000, one])
    return (a[:, :, None] * b[:, None, :]).reshape(len(a), 9)


def ratio(rows):
    """The smallest singular value over the largest."""
    values = np.linalg.svd(rows, compute_uv=False)
    return values[-1] / values[0]


@pytest.mark.parametrize("projection", ["affine", "perspective"])
def test_scenes_have_the_geometry_of_their_kind(projection):
    flat, rigid, deformable = (scene(kind, projection, 51) for kind in ("flat", "rigid", "deformable"))
    assert ratio(homography_rows(flat.dense_source, flat.dense_target)) < 1e-12
    assert ratio(homography_rows(rigid.dense_source, rigid.dense_target)) > 1e-5
    assert ratio(epipolar_rows(rigid.dense_source, rigid.dense_target)) < 1e-12
    assert ratio(epipolar_rows(deformable.dense_source, deformable.dense_target)) > 1e-5


@pytest.mark.parametrize("kind", ["flat", "rigid", "deformable"])
def test_affine_cameras_have_no_perspective(kind):
    joint = np.hstack([scene(kind, "affine", 51).dense_source, scene(kind, "affine", 51).dense_target])
    values = np.linalg.svd(joint - joint.mean(axis=0), compute_uv=False) / 1e4
    # Four coordinates are linear in two or three of space; a sheet bent anew has more.
    assert (values > 1e-6).sum() == {"flat": 2, "rigid": 3, "deformable": 4}[kind]
    joint = np.hstack(
        [scene(kind, "perspective", 51).dense_source, scene(kind, "perspective", 51).dense_target]
    )
    assert (np.linalg.svd(joint - joint.mean(axis=0), compute_uv=False) / 1e4 > 1e-6).sum() == 4


@pytest.mark.parametrize("kind", ["flat", "rigid", "deformable"])
@pytest.mark.parametrize("projection", ["affine", "perspective"])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_contour_is_closed_smooth_and_on_the_sheet(kind, projection, seed):
    seen = scene(kind, projection, 51, seed=seed)
    tree = cKDTree(seen.dense_source)
    for contour, dense in (
        (seen.contour_source, seen.dense_source),
        (seen.contour_target, seen.dense_target),
    ):
        steps = np.linalg.norm(contour - np.roll(contour, 1, axis=0), axis=1)
        assert 0 < steps.min() <= steps.max() < 50
        assert is_simple(contour)
        assert (np.ptp(contour, axis=0) > 0.4 * np.ptp(dense, axis=0)).all()
        assert (contour >= 0).all()
        assert (contour <= IMAGE_SIZE).all()
    # The two contours are images of the same points.
    _, nearest = tree.query(seen.contour_source)
    assert np.linalg.norm(seen.dense_target[nearest] - seen.contour_target, axis=1).max() < 80


def test_scenes_are_reproducible():
    again = [scene("rigid", "perspective", 51, seed=seed) for seed in (0, 0, 1)]
    np.testing.assert_array_equal(again[0].source, again[1].source)
    assert np.abs(again[0].source - again[2].source).max() > 5


C = Configuration(0, 1, 0)
REFUSED = {
    "no points": ("n", lambda: correspondences(C, 0)),
    "text for n": ("n", lambda: correspondences(C, "15")),
    "a fraction of a point": ("n", lambda: correspondences(C, 1.5)),
    "negative noise": ("noise", lambda: correspondences(C, 15, noise=-1.0)),
    "infinite noise": ("noise", lambda: correspondences(C, 15, noise=inf)),
    "negative seed": ("seed", lambda: correspondences(C, 15, seed=-1)),
    "no seed": ("seed", lambda: correspondences(C, 15, seed=None)),
    "a tuple": ("configuration", lambda: correspondences((0, 1, 0), 15)),
    "one sheet": ("target", lambda: Configuration(3, 3, 0)),
    "an eleventh sheet": ("target", lambda: Configuration(3, 10, 0)),
    "a negative sheet": ("source", lambda: Configuration(-1, 1, 0)),
    "a sixth view": ("view", lambda: Configuration(0, 1, 5)),
    "true for a view": ("view", lambda: Configuration(0, 1, True)),
    "seed of sheets": ("seed", lambda: sheets("a")),
    "a number for a setting": ("setting", lambda: correspondences(C, 15, setting=7)),
    "words for the setting of sheets": ("setting", lambda: sheets(0, "smooth")),
    "no waves": ("waves", lambda: Setting(waves=0)),
    "an endless decay": ("decay", lambda: Setting(decay=inf)),
    "one angle": ("tilt", lambda: Setting(tilt=0.3)),
    "three angles": ("tilt", lambda: Setting(tilt=(0.3, 0.2, 0.1))),
    "the smallest angle first": ("tilt", lambda: Setting(tilt=(0.1, 0.3))),
    "a view from the side": ("tilt", lambda: Setting(tilt=(1.6, 0.3))),
    "no distance": ("fill", lambda: Setting(fill=0.0)),
    "beside the sheet": ("points", lambda: sheets()[0]([[0.81, 0]])),
    "nan on the sheet": ("points", lambda: sheets()[0]([[nan, 0]])),
    "normals of points in space": ("points", lambda: sheets()[0].normals([[0, 0, 0]])),
    "crossing rulings": ("upper", lambda: Sheet([0, 1], [1, 0], [0, 0])),
    "too few angles": ("angles", lambda: Sheet([0, 1], [0, 1], [0])),
    "several angles a ruling": ("angles", lambda: Sheet([0, 1], [0, 1], np.zeros((2, 2)))),
    "no rulings": ("lower", lambda: Sheet([], [], [])),
    "a number of rulings": ("lower", lambda: Sheet(3, 3, 3)),
    "no width": ("width", lambda: Sheet([0], [0], [0], width=0)),
    "no direction": ("turn", lambda: Sheet([0], [0], [0], turn=nan)),
    "no columns": ("columns", lambda: sheets()[0].grid(0, 3)),
    "no border": ("count", lambda: sheets()[0].border(0)),
    "a stretching camera": ("rotation", lambda: Camera(35, 2 * np.eye(3), [0, 0, 1])),
    "a mirroring camera": ("rotation", lambda: Camera(35, -np.eye(3), [0, 0, 1])),
    "a camera in front": ("translation", lambda: Camera(35, np.eye(3), [0, 0, -1])),
    "two numbers": ("translation", lambda: Camera(35, np.eye(3), [0, 1])),
    "no focal length": ("focal", lambda: Camera(0, np.eye(3), [0, 0, 1])),
    "number for a flag": ("affine", lambda: Camera(35, np.eye(3), [0, 0, 1], affine=1)),
    "behind the camera": ("points", lambda: Camera(35, np.eye(3), [0, 0, 1])([[0, 0, -2]])),
    "flat points": ("points", lambda: Camera(35, np.eye(3), [0, 0, 1])([[0, 0]])),
    "another scene": ("kind", lambda: scene("bent", "affine", 51)),
    "no kind": ("kind", lambda: scene(None, "affine", 51)),
    "another projection": ("projection", lambda: scene("flat", "orthographic", 51)),
    "no points in a scene": ("n", lambda: scene("flat", "affine", 0)),
    "noise in words": ("noise", lambda: scene("flat", "affine", 51, noise="1")),
}


@pytest.mark.parametrize("case", REFUSED)
def test_wrong_input_is_refused(case):
    name, call = REFUSED[case]
    refused(call, name)
