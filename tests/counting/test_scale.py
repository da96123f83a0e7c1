"""Metres in a picture: by a quadrat, by altitude and lens, by a length; each against a scene projected by hand."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest

from oysterbench.core.errors import LabelError, OptionError, SequenceError
from oysterbench.counting.lens import Lens, read_lens
from oysterbench.counting.per_picture import ALTITUDE, CORNERS, altitudes, quadrats
from oysterbench.counting.scale import AltitudeScale, PlainScale, QuadratScale, area_m2, border, length_and_width_mm
from oysterbench.counting.sources import Source, find_sources
from oysterbench.counting.tables import read_table
from oysterbench.report.renderers.csv import field

SHAPE = (480, 640)
MATRIX = np.array([[400.0, 0, 330], [0, 410, 235], [0, 0, 1]])


def oblique(points_m):
    """(N, 2) px from the corner of the first pixel: where a camera that looks down aslant sees points of the bottom."""
    turn = cv2.Rodrigues(np.array([0.5, 0.1, 0.2]))[0]
    places = np.concatenate([points_m, np.zeros((len(points_m), 1))], axis=1)
    found = cv2.projectPoints(places, turn, np.array([-0.2, -0.2, 1.0]), MATRIX, np.zeros(4))[0]
    return found.reshape(-1, 2) + 0.5


SQUARE = np.array([[0, 0], [0.5, 0], [0.5, 0.5], [0, 0.5]])


def test_lengths_in_an_oblique_quadrat_are_those_on_the_bottom():
    scale = QuadratScale(0.5, oblique(SQUARE))
    shell = np.array([[0.1, 0.1], [0.19, 0.1], [0.19, 0.16], [0.1, 0.16]])
    assert length_and_width_mm(scale, oblique(shell)) == pytest.approx((90, 60), rel=1e-3)
    assert area_m2(scale, SHAPE) == pytest.approx(0.25, rel=1e-3)


def test_corners_may_come_in_any_order():
    corners = oblique(SQUARE)
    shell = oblique(np.array([[0.1, 0.1], [0.19, 0.1], [0.19, 0.16], [0.1, 0.16]]))
    for order in itertools.permutations(range(4)):
        scale = QuadratScale(0.5, corners[list(order)])
        assert area_m2(scale, SHAPE) == pytest.approx(0.25, rel=1e-3)
        assert length_and_width_mm(scale, shell) == pytest.approx((90, 60), rel=1e-3)


def test_of_a_quadrat_that_leaves_the_picture_only_what_is_seen_is_ground():
    corners = np.array([[-100, 100], [100, 100], [100, 300], [-100, 300.0]])
    assert area_m2(QuadratScale(1.0, corners), SHAPE) == pytest.approx(0.5)
    assert area_m2(QuadratScale(1.0, corners - 300), SHAPE) == 0.0


@pytest.mark.parametrize(
    "corners",
    [
        [[0, 0], [100, 0], [50, 30], [50, 100]],  # one within the triangle of the others
        [[0, 0], [50, 0], [100, 0], [50, 80]],  # three on a line
        [[0, 0], [3, 0], [3, 3], [0, 3]],
        [[0, 0], [1, 0], [0, 1], [np.nan, 1]],
    ],
)
def test_four_points_that_are_no_quadrat_are_refused(corners):
    with pytest.raises(LabelError, match=r"^c\.csv: a: expected (the )?four corners"):
        QuadratScale(0.5, np.array(corners, dtype=float), "c.csv: a")


def test_corners_as_fractions_of_the_picture_are_recognised():
    with pytest.raises(
        LabelError, match=r"^c\.csv: a: expected corners in px .* got fractions .* multiply x by its width"
    ):
        QuadratScale(0.5, np.array([[0.1, 0.2], [0.9, 0.2], [0.9, 1.0], [0.0, 0.7]]), "c.csv: a")


@pytest.mark.parametrize("model", ["plumb_bob", "equidistant"])
def test_from_an_altitude_a_distorted_picture_has_the_area_and_lengths_of_the_bottom(model):
    distortion = np.array([-0.2, 0.05, 0.001, -0.002] if model == "plumb_bob" else [0.02, -0.01, 0.003, 0.0])
    scale = AltitudeScale(Lens(640, 480, MATRIX, distortion, model), 1.5)
    shell_m = np.array([[0.5, 0.3], [0.6, 0.3], [0.6, 0.36], [0.5, 0.36]])
    places = np.concatenate([shell_m, np.full((4, 1), 1.5)], axis=1).reshape(-1, 1, 3)
    project = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    seen = project(places, np.zeros(3), np.zeros(3), MATRIX, distortion)[0]
    assert length_and_width_mm(scale, seen.reshape(-1, 2) + 0.5) == pytest.approx((100, 60), rel=1e-3)
    # The border of the ground by casting many rays: the area by the pixels' own Jacobians.
    x, y = np.meshgrid(np.arange(641), np.arange(481))
    ground = scale.to_ground(np.stack([x.ravel(), y.ravel()], axis=1)).reshape(481, 641, 2)
    across, down = np.diff(ground, axis=1)[:-1], np.diff(ground, axis=0)[:, :-1]
    cells = np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0])
    assert area_m2(scale, SHAPE) == pytest.approx(float(cells.sum()), rel=2e-3)


def test_without_distortion_the_area_is_that_of_a_rectangle():
    scale = AltitudeScale(Lens(640, 480, MATRIX, np.zeros(4)), 2.0)
    assert area_m2(scale, SHAPE) == pytest.approx(640 / 400 * 2 * 480 / 410 * 2)


def test_a_calibration_holds_for_the_same_pictures_at_another_size_and_no_others():
    scale = AltitudeScale(Lens(640, 480, MATRIX, np.array([-0.1, 0, 0, 0])), 1.0)
    twice = scale.fitted((960, 1280))
    assert area_m2(twice, (960, 1280)) == pytest.approx(area_m2(scale, SHAPE), rel=1e-3)
    points = np.array([[100.0, 200.0], [600, 30]])
    assert twice.to_ground(2 * points) == pytest.approx(scale.to_ground(points), abs=1e-6)
    with pytest.raises(SequenceError, match="of images of 640 x 480 px, got one of 640 x 360"):
        scale.fitted((360, 640))


@pytest.mark.parametrize("model", ["plumb_bob", "equidistant"])
def test_a_calibration_with_frames_as_they_are_stored_holds_where_they_are_made_wider(model):
    distortion = np.array([-0.2, 0.05, 0.001, -0.002] if model == "plumb_bob" else [0.02, -0.01, 0.003, 0.0])
    stored = AltitudeScale(Lens(640, 480, MATRIX, distortion, model), 1.5)
    points = np.array([[100.0, 200.0], [600, 30], [20, 450]])
    wide = stored.fitted((480, 853), 640)
    assert wide.to_ground(points * [853 / 640, 1]) == pytest.approx(stored.to_ground(points), abs=1e-9)
    assert area_m2(wide, (480, 853)) == pytest.approx(area_m2(stored, SHAPE), rel=1e-3)
    half = stored.fitted((240, 427), 320)
    assert half.to_ground(points * [427 / 640, 0.5]) == pytest.approx(stored.to_ground(points), abs=1e-9)
    upright = stored.fitted((640, 360), 480)  # held upright, pixels are as much higher
    turned = np.stack([480 - points[:, 1], points[:, 0]], axis=1) * [0.75, 1]
    x, y = stored.to_ground(points).T
    assert upright.to_ground(turned) == pytest.approx(np.stack([-y, x], axis=1), abs=1e-9)
    shown = AltitudeScale(Lens(853, 480, MATRIX, np.zeros(4)), 1.0)
    assert shown.fitted((480, 853), 640).lens is shown.lens, "calibrated with widened frames"


@pytest.mark.parametrize("model", ["plumb_bob", "equidistant"])
def test_upright_pictures_are_of_the_lens_turned(model):
    distortion = np.array([-0.2, 0.05, 0.001, -0.002] if model == "plumb_bob" else [0.02, -0.01, 0.003, 0.0])
    lens = Lens(640, 480, MATRIX, distortion, model)
    lying, upright = AltitudeScale(lens, 1.5), AltitudeScale(lens, 1.5).fitted((640, 480))
    assert area_m2(upright, (640, 480)) == pytest.approx(area_m2(lying, SHAPE), rel=1e-9)
    points = np.array([[100.0, 200.0], [600, 30], [20, 450]])
    turned = np.stack([480 - points[:, 1], points[:, 0]], axis=1)  # a quarter clockwise
    x, y = lying.to_ground(points).T
    assert upright.to_ground(turned) == pytest.approx(np.stack([-y, x], axis=1), abs=1e-9)
    assert area_m2(lying.fitted((1280, 960)), (1280, 960)) == pytest.approx(area_m2(lying, SHAPE), rel=1e-3)


def test_a_lens_that_cannot_be_undone_at_the_border_is_refused():
    with pytest.raises(SequenceError, match="cannot be undone"):
        AltitudeScale(Lens(640, 480, MATRIX, np.array([-0.9, 0.1, 0, 0])), 1.0).to_ground(border(SHAPE))


def test_a_border_goes_round_once_also_for_one_pixel():
    assert area_m2(PlainScale(1000.0), (1, 1)) == pytest.approx(1.0)
    assert area_m2(PlainScale(1.0), (3000, 4000)) == pytest.approx(12.0)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_a_scale_is_above_zero(value):
    with pytest.raises(OptionError, match="expected millimetres above 0"):
        PlainScale(value)
    with pytest.raises(OptionError, match="expected metres above 0"):
        AltitudeScale(Lens(640, 480, MATRIX, np.zeros(4)), value)
    with pytest.raises(OptionError, match="expected metres above 0"):
        QuadratScale(value, oblique(SQUARE))


def test_a_quadrat_in_centimetres_is_refused():
    with pytest.raises(OptionError, match=r"at most 10, got 50: 50 cm are --quadrat 0\.5"):
        QuadratScale(50.0, oblique(SQUARE))
    with pytest.raises(OptionError, match=r"got 500: 500 mm are --quadrat 0\.5"):
        QuadratScale(500.0, oblique(SQUARE))


def test_corners_of_a_larger_copy_of_the_picture_are_refused():
    corners = np.array([[400, 300], [1200, 300], [1200, 1100], [400, 1100.0]])  # of one of twice its size
    with pytest.raises(LabelError, match=r"reef\.csv: a: expected corners within the image of 640 x 480 px, got \("):
        QuadratScale(0.5, corners, "reef.csv: a").fitted((480, 640))
    whole = QuadratScale(0.5, corners / 2)
    assert whole.fitted((480, 640)) is whole


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize(
    "corners",
    [
        [(640, 100), (1200, 100), (1200, 400), (640, 400)],
        [(100, 480), (500, 480), (520, 900), (80, 900)],
        [(-160, 600), (0, 480), (0, 360), (-160, 0)],
    ],
)
def test_a_quadrat_beside_the_picture_that_touches_its_border_is_refused(corners, turn):
    with pytest.raises(LabelError, match="expected corners within the image"):
        QuadratScale(0.5, np.roll(np.array(corners, dtype=float), turn, axis=0)).fitted((480, 640))


@pytest.mark.parametrize(
    ("focal", "k1", "k2"), [(484.0, -0.404, 0.043), (484.0, -0.45, 0.05), (400.0, -0.5, 0.1), (300.0, -0.35, 0.05)]
)
def test_a_lens_that_folds_within_the_image_is_refused(focal, k1, k2):
    matrix = np.array([[focal, 0, 319.5], [0, focal, 239.5], [0, 0, 1]])
    with pytest.raises(SequenceError, match="cannot be undone"):
        Lens(640, 480, matrix, np.array([k1, k2, 0, 0])).rays(border(SHAPE))


def test_a_wide_lens_is_undone_at_its_border():
    lens = Lens(640, 480, np.array([[320.0, 0, 319.5], [0, 320.0, 239.5], [0, 0, 1]]), np.array([-0.3, 0.12, 0, 0]))
    points, still = border(SHAPE), np.zeros(3)
    rays = np.column_stack([lens.rays(points), np.ones(len(points))])
    again = cv2.projectPoints(rays, still, still, lens.matrix, lens.distortion)[0].reshape(-1, 2)
    assert again == pytest.approx(points, abs=1e-6)


KALIBR = """
cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.1, 0.02, 0.0, 0.001]
  distortion_model: radtan
  intrinsics: [400.0, 410.0, 330.0, 235.0]
  resolution: [640, 480]
cam1:
  camera_model: pinhole
  distortion_coeffs: [0.1, 0.0, 0.0, 0.0]
  distortion_model: equidistant
  intrinsics:
  - 300.0
  - 300.0
  - 320.0
  - 240.0
  resolution: [640, 480]
"""
EUROC = """# a comment
sensor_type: camera
resolution: [640, 480]
camera_model: pinhole
intrinsics: [400.0, 410.0, 330.0, 235.0] # fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.1, 0.02, 0.0, 0.001]
"""
ROS = """
image_width: 640
image_height: 480
camera_matrix: {rows: 3, cols: 3, data: [400.0, 0.0, 330.0, 0.0, 410.0, 235.0, 0.0, 0.0, 1.0]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.02, 0.0, 0.001, 0.0]}
"""


@pytest.mark.parametrize("text", [KALIBR, EUROC, ROS])
def test_a_calibration_is_read_from_the_usual_files(tmp_path, text):
    (tmp_path / "c.yaml").write_text(text)
    lens = read_lens(tmp_path / "c.yaml")
    assert (lens.width, lens.height, lens.model) == (640, 480, "plumb_bob")
    assert np.array_equal(lens.matrix, MATRIX)
    assert lens.distortion[:4] == pytest.approx([-0.1, 0.02, 0.0, 0.001])


@pytest.mark.parametrize("coefficients", ["distortion_coefficients: []", ""])
def test_a_calibration_without_distortion_needs_no_coefficients(tmp_path, coefficients):
    head = EUROC.replace("radial-tangential", "none").partition("distortion_coefficients")[0]
    (tmp_path / "lens.yaml").write_text(head + coefficients)
    assert read_lens(tmp_path / "lens.yaml").distortion.tolist() == [0.0, 0.0, 0.0, 0.0]


def test_of_several_cameras_one_is_chosen_by_its_name(tmp_path):
    (tmp_path / "c.yaml").write_text(KALIBR)
    assert read_lens(tmp_path / "c.yaml", "cam1").model == "equidistant"
    with pytest.raises(SequenceError, match="no camera 'left'; its cameras: cam0, cam1"):
        read_lens(tmp_path / "c.yaml", "left")


def test_the_calibration_that_an_export_writes_and_that_of_the_sequence_are_one(dive_file, tmp_path):
    from oysterbench.sequence import open_sequence
    from oysterbench.sequence.export import export_sequence

    sequence = open_sequence(dive_file)
    folder = export_sequence(sequence, "kalibr", tmp_path / "out", False)[0]
    of_file, of_sequence = read_lens(folder / "camchain-imucam.yaml"), read_lens(dive_file)
    assert of_file.matrix == pytest.approx(of_sequence.matrix)
    assert (of_file.width, of_file.height, of_file.model) == (of_sequence.width, of_sequence.height, of_sequence.model)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: [", "not YAML"),
        ("7", "expected a calibration"),
        ("cam0: {intrinsics: [1, 2, 3, 4]}", "key 'distortion_coefficients' is missing"),
        (EUROC.replace("[400.0, 410.0, 330.0, 235.0]", "[400.0]"), "expected 4 numbers"),
        (EUROC.replace("radial-tangential", "fov"), "distortion_model: expected plumb_bob"),
        (KALIBR.replace("camera_model: pinhole", "camera_model: omni"), "camera_model: expected pinhole, got omni"),
    ],
)
def test_what_is_no_calibration_is_one_line(tmp_path, text, said):
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(SequenceError, match=f"c.yaml: .*{said}"):
        read_lens(tmp_path / "c.yaml")


@pytest.fixture
def sources(tmp_path):
    for name in ("a/1.jpg", "b/1.jpg", "b/2 ü.png", "dive.mp4"):
        (tmp_path / "in" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "in" / name).write_bytes(b"x")
    return find_sources([tmp_path / "in"]).sources


def table(tmp_path, text, sources, columns=CORNERS):
    (tmp_path / "t.csv").write_text(text, encoding="utf-8")
    return read_table(tmp_path / "t.csv", columns, sources)


def test_a_table_names_pictures_by_name_or_file_and_frames_by_their_video(tmp_path, sources):
    found = table(
        tmp_path,
        "altitude_m,image\n1,a/1\n2,b/1.jpg\n3,2 ü.png\n4,dive.mp4\n5,dive.mp4/000030\n6,zz\n",
        sources,
        ALTITUDE,
    )
    dive = Source("dive.mp4", tmp_path, True)
    assert [found.of(source, source.name) for source in sources] == [(1,), (2,), (3,), (4,)]
    assert (found.of(dive, "dive.mp4/000000"), found.of(dive, "dive.mp4/000030")) == ((4,), (5,))
    assert found.unused == ("zz",)


def test_frames_are_known_by_their_number_however_it_is_written(tmp_path, sources):
    found = table(tmp_path, "image,altitude_m\ndive.mp4/30,1\ndive.mp4/0000060,2\ndive.mp4/0,3\n", sources, ALTITUDE)
    assert found.rows == {f"dive.mp4/{number:06d}": (height,) for number, height in ((30, 1), (60, 2), (0, 3))}
    assert found.besides({"dive.mp4/000000", "dive.mp4/000060"}) == ("dive.mp4/000030",)
    assert table(tmp_path, "image,altitude_m\ndive.mp4/x,1\n", sources, ALTITUDE).unused == ("dive.mp4/x",)
    with pytest.raises(LabelError, match=r"t\.csv:3: dive\.mp4/030 is listed twice"):
        table(tmp_path, "image,altitude_m\ndive.mp4/30,1\ndive.mp4/030,1\n", sources, ALTITUDE)


def test_names_with_umlauts_are_the_same_however_they_are_composed(tmp_path):
    names = ("Bo\u0308schung 1.jpg", "Mu\u0308ll.mp4", "Mu\u0308ll 2.png")
    for name in names:
        (tmp_path / name).write_bytes(b"x")
    sources = find_sources([tmp_path]).sources
    text = "image,altitude_m\nB\u00f6schung 1,1\nM\u00fcll.mp4/000010,2\nM\u00fcll 2.png,3\n"
    assert table(tmp_path, text, sources, ALTITUDE).rows == {
        "Bo\u0308schung 1": (1.0,),
        "Mu\u0308ll.mp4/000010": (2.0,),
        "Mu\u0308ll 2": (3.0,),
    }


def test_names_may_have_the_apostrophe_that_images_csv_puts_before_formulas(tmp_path):
    for name in ("=1+1.jpg", "-lead.mp4", "'quoted.png"):
        (tmp_path / name).write_bytes(b"x")
    sources = find_sources([tmp_path]).sources
    text = "image,altitude_m\n" + "".join(f"{field(n)},1\n" for n in ("=1+1", "-lead.mp4/000010", "'quoted"))
    assert "\n'=1+1,1\n'-lead" in text
    assert set(table(tmp_path, text, sources, ALTITUDE).rows) == {"=1+1", "-lead.mp4/000010", "'quoted"}
    assert table(tmp_path, "image,altitude_m\n'x,1\n", sources, ALTITUDE).unused == ("'x",)


@pytest.mark.parametrize("mark", [";", "\t"])
def test_a_table_of_a_spreadsheet_may_have_semicolons_or_tabs_and_decimal_commas(mark, tmp_path, sources):
    text = f"\ufeffimage{mark}altitude_m\na/1{mark}1,25\n\n"
    assert table(tmp_path, text, sources, ALTITUDE).rows == {"a/1": (1.25,)}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", ":1: expected the columns image,altitude_m"),
        ("name,altitude_m\n", ":1: expected the columns image,altitude_m, missing: image"),
        ("image,altitude_m\na/1,high\n", ":2: expected a number, got 'high'"),
        ("image,altitude_m\na/1\n", ":2: expected 2 values, got 1"),
        ("image,altitude_m\na/1,1\na/1.jpg,2\n", ":3: a/1.jpg is listed twice"),
        ("image,altitude_m\n1.jpg,1\n", ":2: 2 images are called '1.jpg': expected one of a/1, b/1"),
        pytest.param(f"image,altitude_m\na/1,{'1' * 140_000}\n", ":2: cannot be read as CSV: field", id="long field"),
    ],
)
def test_a_table_that_is_wrong_is_refused_by_its_line(tmp_path, sources, text, said):
    with pytest.raises(LabelError, match=rf"t.csv{said}"):
        table(tmp_path, text, sources, ALTITUDE)


def test_a_picture_without_corners_or_altitude_is_not_counted(tmp_path, sources):
    corners = table(tmp_path, f"image,{','.join(CORNERS)}\na/1,10,10,90,10,90,90,10,90\n", sources)
    scale = quadrats(0.5, corners)
    assert area_m2(scale(sources[0], "a/1"), SHAPE) == pytest.approx(0.25)
    with pytest.raises(LabelError, match=r"b/1: .*t\.csv has no corners for it"):
        scale(sources[1], "b/1")
    heights = table(tmp_path, "image,altitude_m\na/1,2\n", sources, ALTITUDE)
    with pytest.raises(LabelError, match=r"b/1: .*t\.csv has no altitude for it"):
        altitudes(Lens(640, 480, MATRIX, np.zeros(4)), heights)(sources[1], "b/1")
