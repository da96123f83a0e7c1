"""oysterbench segment, as biologists type it: one line for what is wrong, and exit codes that say how it went."""

from __future__ import annotations

import csv
import json

import cv2
import pytest

from oysterbench.results.records import ResultRecord, write_results
from tests.helpers.command import assert_one_line, run
from tests.helpers.people_pictures import discs, write, write_video

DISCS = ("--method", "tests.helpers.people_pictures:Discs")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for k in range(6):
        pixels = discs((40, 40), (100, 60))
        pixels[0, k] = 1  # no copy of another
        write(tmp_path / "Fotos ü" / f"{k}.png", pixels)
    return tmp_path / "Fotos ü"


def test_a_folder_of_pictures_becomes_a_page_and_tables(folder, tmp_path):
    done = run("segment", folder, *DISCS, "--out", "out")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("out/index.html\n")
    assert "12 oysters in 6 images" in done.stdout
    assert "Oysters per image: 2.0 [1.0 to 3.5]" in done.stdout
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        *("index.html", "images.csv", "oysters.csv", "summary.json", "masks", "overlays", "finished")
    }
    again = run("segment", folder, *DISCS, "--out", "out")
    assert "all finished before" in again.stdout


def test_files_that_no_count_has_left_are_not_overwritten(folder, tmp_path):
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "index.html").write_text("mine")
    done = run("segment", folder, *DISCS, "--out", "site")
    assert_one_line(done, "site: the count would overwrite index.html, which no count has left there")
    assert (tmp_path / "site" / "index.html").read_text() == "mine"
    assert not (tmp_path / "site" / "masks").exists()
    (folder / "instances.json").write_text("{}")
    assert run("segment", folder / "0.png", *DISCS, "--out", folder).returncode == 0
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "broken.jpg").write_bytes(b"\xff\xd8")
    for _ in range(2):  # of a count in which nothing could be counted there is no picture
        done = run("segment", "empty", *DISCS, "--out", "nothing")
        assert "1 of 1 could not be counted" in done.stderr


def test_a_picture_at_several_paths_is_counted_once(folder, tmp_path):
    (folder / "link.png").symlink_to(folder / "3.png")
    (tmp_path / "same").symlink_to(folder)
    done = run("segment", folder, tmp_path / "same" / "5.png", *DISCS, "--out", "out")
    assert "12 oysters in 6 images" in done.stdout
    assert "left out because they are links to, or other paths of, what is counted: link.png, 5.png" in done.stderr


def test_tables_call_a_picture_by_one_name_that_no_spreadsheet_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "in" / "=1+2.png", discs((40, 40)))
    assert run("segment", "in", *DISCS, "--out", "out").returncode == 0
    for name in ("images.csv", "oysters.csv"):
        with open(tmp_path / "out" / name, encoding="utf-8", newline="") as file:
            assert [row["image"] for row in csv.DictReader(file)] == ["'=1+2"], name


def test_a_carriage_return_in_a_name_ends_no_line_of_a_table(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "in" / "a\rb.png", discs((40, 40)))
    assert run("segment", "in", *DISCS, "--out", "out").returncode == 0
    with open(tmp_path / "out" / "images.csv", encoding="utf-8", newline="") as file:
        assert [row["image"] for row in csv.DictReader(file)] == ["a\N{SYMBOL FOR CARRIAGE RETURN}b"]


def test_copies_of_pictures_are_warned_of(folder, tmp_path):
    (folder / "copy").mkdir()
    (folder / "copy" / "3.png").write_bytes((folder / "3.png").read_bytes())
    done = run("segment", folder, *DISCS, "--out", "out")
    said = "1 file is a copy of another and counted as often, which makes intervals too narrow: copy/3 is 3"
    assert said in done.stderr
    assert said in (tmp_path / "out" / "index.html").read_text()


def test_a_picture_in_two_formats_is_warned_of_and_counted_when_the_count_is_resumed_too(folder, tmp_path):
    (folder / "copy").mkdir()
    pixels = cv2.resize(discs((40, 40), (100, 60)), None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
    write(folder / "mine.png", pixels)
    assert cv2.imwrite(str(folder / "copy" / "IMG_1.jpg"), pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])
    said = "1 file is a copy of another and counted as often, which makes intervals too narrow: mine is copy/IMG_1"
    for _ in range(2):
        done = run("segment", folder, *DISCS, "--out", "out")
        assert said in done.stderr
        assert "in 8 images" in done.stdout


def test_a_quadrat_in_another_unit_is_one_line(folder, tmp_path):
    (tmp_path / "corners.csv").write_text("image,x1,y1,x2,y2,x3,y3,x4,y4\n0,10,10,90,10,90,80,10,80\n")
    done = run("segment", folder, *DISCS, "--quadrat", "50", "--corners", tmp_path / "corners.csv")
    assert_one_line(done, "--quadrat: expected the side in metres, at most 10, got 50: 50 cm are --quadrat 0.5", 2)


def test_its_own_masks_are_read_as_what_they_are(folder, tmp_path):
    """Of touching oysters, too, of which a mask is one part."""
    write(folder / "6.png", discs((40, 40), (52, 40)))
    assert run("segment", folder, *DISCS, "--out", "out", "--coco").returncode == 0
    words = ("--truth", "out/instances.json", "--estimate", "out/masks", "--json")
    for track, of in (("detection", "ap_mask"), ("segmentation", "iou")):
        done = run("eval", track, *words)
        assert done.returncode == 0, done.stderr
        (result,) = json.loads(done.stdout)["results"]
        assert result["metrics"][of] > 0.99


def test_masks_of_pictures_that_are_gone_are_told_of(folder, tmp_path):
    assert "earlier counts" not in run("segment", folder, *DISCS, "--out", "out").stderr
    (folder / "2.png").unlink()
    (folder / "4.png").unlink()
    done = run("segment", folder, *DISCS, "--out", "out")
    assert "8 oysters in 4 images" in done.stdout
    assert "out: masks and overlays of 2 images and frames of earlier counts are still there" in done.stderr
    assert done.stderr.rstrip().endswith("2, 4")
    assert (tmp_path / "out" / "masks" / "2.png").is_file()


def test_annotations_of_an_earlier_count_are_told_of(folder):
    told = "instances.json is of an earlier count, and may not agree with the tables: --coco writes it anew"
    assert told not in run("segment", folder, *DISCS, "--out", "out", "--coco").stderr
    assert told in run("segment", folder, *DISCS, "--out", "out").stderr
    assert told not in run("segment", folder, *DISCS, "--out", "out", "--coco").stderr


def test_corrected_annotations_are_not_overwritten(folder, tmp_path):
    assert run("segment", folder, *DISCS, "--out", "out", "--coco").returncode == 0
    path = tmp_path / "out" / "instances.json"
    document = json.loads(path.read_text())
    del document["annotations"][0]
    path.write_text(json.dumps(document))
    done = run("segment", folder, *DISCS, "--out", "out", "--coco", "--again")
    assert_one_line(done, "though it was changed by hand or is of an earlier version: move it elsewhere first")
    assert "may not agree with the tables\n" in run("segment", folder, *DISCS, "--out", "out").stderr
    assert json.loads(path.read_text()) == document
    path.rename(tmp_path / "corrected.json")
    assert run("segment", folder, *DISCS, "--out", "out", "--coco").returncode == 0
    assert len(json.loads(path.read_text())["annotations"]) == len(document["annotations"]) + 1


@pytest.mark.parametrize("words", [("--out", ""), ("--out=",), ("",)])
def test_an_empty_argument_is_no_folder(folder, words):
    done = run("segment", folder, *DISCS, *words)
    assert done.returncode == 2
    assert "expected a value, got an empty one: is a variable of the shell not set?" in done.stderr
    assert not list(folder.glob("*.csv"))


def test_results_within_the_folder_of_pictures_are_not_taken_for_pictures(folder):
    for _ in range(2):
        done = run("segment", folder, *DISCS, "--out", folder / "out", "--json")
        assert json.loads(done.stdout)["images"] == 6
        assert done.returncode == 0


def test_json_is_all_there_is_on_stdout(folder):
    done = run("segment", folder, *DISCS, "--json", "--mm-per-px", 2)
    summary = json.loads(done.stdout)
    assert summary["measures"]["per_m2"]["value"] == pytest.approx(2 / (0.24 * 0.32))
    assert summary["files"][0] == "Fotos ü-oysters/index.html"


def test_what_is_no_picture_is_a_line_and_what_is_broken_an_exit_code(folder):
    (folder / "notes.txt").write_text("x")
    done = run("segment", folder, *DISCS)
    assert done.returncode == 0
    assert "left out because they are neither image nor video: notes.txt" in done.stderr
    (folder / "broken.jpg").write_bytes(b"\xff\xd8")
    done = run("segment", folder, *DISCS)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "oysterbench: 1 of 7 could not be counted; the rest was counted"
    assert "broken.jpg: the JPEG is damaged" in done.stderr
    assert "12 oysters in 6 images" in done.stdout


def test_an_image_in_a_format_that_cannot_be_read_is_one_that_could_not_be_counted(folder, tmp_path):
    for name in ("0.HEIC", "phone.HEIC"):
        (folder / name).write_bytes(b"x")
    done = run("segment", folder, *DISCS, "--out", "out")
    assert done.returncode == 1
    assert "left out because an image of the same name is beside them: 0.HEIC" in done.stderr
    assert "phone.HEIC: a format that cannot be read: save it as JPEG, PNG or TIFF" in done.stderr
    assert "phone.HEIC" in (tmp_path / "out" / "images.csv").read_text()


def test_unlike_pictures_are_warned_of_in_one_line(folder):
    write(folder / "strange.png", discs())
    done = run("segment", folder, *DISCS)
    assert done.returncode == 0
    assert "their counts are not reliable: 1 of 7 images: strange" in done.stderr


LIGHT = ("--method", "tests.helpers.image_methods:Light")


def test_of_a_mask_it_is_said_that_its_parts_are_no_separate_oysters_and_that_nothing_tells_strange_images(folder):
    speck = discs((40, 40), (100, 60))
    speck[5, 5:8] = 200
    write(folder / "0.png", speck)
    done = run("segment", folder, *LIGHT, "--out", "out")
    assert "12 connected parts of a mask, not separate oysters, in 6 images" in done.stdout
    assert "Not counted, smaller than 49 px in an image of 640 px, scaled with the image: 1" in done.stdout
    assert "light has no test of whether images are unlike its training data" in done.stderr
    summary = json.loads(run("segment", folder, *LIGHT, "--out", "out", "--json").stdout)
    assert summary["counted_as"] == "connected parts of a mask, not separate oysters"
    assert (summary["too_small"], summary["novelty_known"], len(summary["warnings"])) == (1, False, 1)
    done = run("segment", folder, *LIGHT, "--out", "out", "--min-px", 0)
    assert "13 connected parts" in done.stdout


def test_a_method_that_knows_the_strange_has_no_doubt_of_its_own(folder):
    done = run("segment", folder, *DISCS)
    assert "has no test" not in done.stderr
    assert "12 oysters in 6 images" in done.stdout


@pytest.mark.parametrize("mm_per_px", [800, 0.0008])
def test_a_scale_in_another_unit_is_warned_of(folder, mm_per_px):
    said = "is the scale in another unit (--mm-per-px takes millimetres per pixel)"
    for method in (DISCS, LIGHT):
        done = run("segment", folder, *method, "--mm-per-px", mm_per_px)
        assert said in done.stderr
        assert said in (folder.parent / "Fotos ü-oysters" / "index.html").read_text(encoding="utf-8")
    assert said not in run("segment", folder, *DISCS, "--mm-per-px", 4).stderr


def test_oysters_that_are_too_short_do_not_count_where_asked(folder):
    done = run("segment", folder, *DISCS, "--mm-per-px", 4, "--min-mm", 90)
    assert "0 oysters in 6 images" in done.stdout
    assert "Not counted, smaller than 90 mm long: 12" in done.stdout


def test_a_video_is_sampled_as_asked(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_video(tmp_path / "dive 1.avi", [discs((60, 60))] * 30)
    for options, frames in (((), 3), (("--rate", 2), 6), (("--every", 10), 3)):
        done = run("segment", "dive 1.avi", *DISCS, *options, "--json")
        assert json.loads(done.stdout)["images"] == frames
    assert (tmp_path / "dive 1-oysters" / "videos" / "dive 1.avi.mp4").is_file()
    assert run("segment", "dive 1.avi", *DISCS, "--rate", 2, "--every", 10).returncode == 2


def test_of_a_video_that_cannot_be_read_nothing_is_said_but_why(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    whole = write_video(tmp_path / "dive.mp4", [discs((60, 60))] * 30, codec="mp4v").read_bytes()
    (tmp_path / "dive.mp4").write_bytes(whole[:-500])
    done = run("segment", "dive.mp4", *DISCS)
    assert (done.returncode, done.stdout) == (1, "")
    assert "dive.mp4: the video cannot be read, none of its frames were" in done.stderr
    assert done.stderr.splitlines()[-1] == "oysterbench: 1 of 1 could not be counted"


def test_a_video_of_sound_alone_says_so(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    whole = write_video(tmp_path / "dive.mp4", [discs((60, 60))] * 5, codec="mp4v").read_bytes()
    assert whole.count(b"vide") == 1  # kind of its only track
    (tmp_path / "dive.mp4").write_bytes(whole.replace(b"vide", b"soun"))
    done = run("segment", "dive.mp4", *DISCS)
    assert "dive.mp4: " in done.stderr
    assert "without images, as of sound alone" in done.stderr


def test_quadrats_altitudes_and_checks_by_files(folder, tmp_path):
    corners = "".join(f"{k}.png,70,20,130,20,130,110,70,110\n" for k in range(6))
    (tmp_path / "c.csv").write_text("image,x1,y1,x2,y2,x3,y3,x4,y4\n" + corners + "gone,1,1,9,1,9,9,1,9\n")
    done = run("segment", folder, *DISCS, "--quadrat", 0.5, "--corners", "c.csv", "--json")
    assert json.loads(done.stdout)["measures"]["per_m2"]["value"] == pytest.approx(4, rel=1e-3)
    assert "c.csv: no image is called gone" in done.stderr
    (tmp_path / "lens.yaml").write_text(
        "intrinsics: [100, 100, 79.5, 59.5]\nresolution: [160, 120]\ndistortion_coeffs: [0, 0, 0, 0]\n"
    )
    for altitude in ("1.5", "heights.csv"):
        (tmp_path / "heights.csv").write_text("image,altitude_m\n" + "".join(f"{k},1.5\n" for k in range(6)))
        done = run("segment", folder, *DISCS, "--altitude", altitude, "--calibration", "lens.yaml", "--json")
        area = 6 * 1.6 * 1.2 * 1.5**2
        assert json.loads(done.stdout)["area_m2"] == pytest.approx(area, rel=1e-6), done.stderr
    write_results(tmp_path / "check" / "results.json", [result("discs")])
    done = run("segment", folder, *DISCS, "--checked", "check", "--json")
    assert json.loads(done.stdout)["count_error_on_labelled_percent"] == pytest.approx(-10)
    write_results(tmp_path / "check" / "results.json", [result("other")])
    assert_one_line(run("segment", folder, *DISCS, "--checked", "check"), "expected results of discs .* got other")


def test_a_check_of_whole_images_is_told_apart_from_a_count_in_quadrats(folder, tmp_path):
    corners = "".join(f"{k},70,20,130,20,130,110,70,110\n" for k in range(6))
    (tmp_path / "c.csv").write_text("image,x1,y1,x2,y2,x3,y3,x4,y4\n" + corners)
    write_results(tmp_path / "check" / "results.json", [result("discs")])
    checked = ("segment", folder, *DISCS, "--checked", "check", "--json", "--out", "out")
    told = "the check counts whole images, this count only quadrats: oysters outside the quadrats that are not labelled"
    assert told not in run(*checked).stderr
    assert "Unlike this page" not in (tmp_path / "out" / "index.html").read_text()
    done = run(*checked, "--quadrat", 0.5, "--corners", "c.csv")
    assert told in done.stderr
    assert any(warning.startswith(told) for warning in json.loads(done.stdout)["warnings"])
    page = (tmp_path / "out" / "index.html").read_text()
    assert "Unlike this page, that check counts what is outside the quadrats, too." in page
    assert "also those outside the quadrat, which instances.json does not have" in page


def test_a_video_that_breaks_off_is_not_said_to_be_uncounted(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_video(tmp_path / "dive.avi", [discs((60, 60))] * 20)
    data = (tmp_path / "dive.avi").read_bytes()
    (tmp_path / "dive.avi").write_bytes(data[: len(data) // 2])
    done = run("segment", "dive.avi", *DISCS, "--rate", 10)
    assert done.returncode == 1
    assert "could not be counted, or not to the end; the rest was counted" in done.stderr


def test_lines_of_frames_that_were_not_counted_are_told_of(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_video(tmp_path / "dive.avi", [discs((60, 60))] * 20)
    (tmp_path / "lens.yaml").write_text(
        "intrinsics: [100, 100, 79.5, 59.5]\nresolution: [160, 120]\ndistortion_coeffs: [0, 0, 0, 0]\n"
    )
    (tmp_path / "heights.csv").write_text("image,altitude_m\ndive.avi,1.5\ndive.avi/10,1\ndive.avi/11,1\n")
    done = run("segment", "dive.avi", *DISCS, "--altitude", "heights.csv", "--calibration", "lens.yaml", "--json")
    assert json.loads(done.stdout)["area_m2"] == pytest.approx(1.6 * 1.2 * (1.5**2 + 1), rel=1e-6)
    assert "heights.csv: no frame that was counted is called dive.avi/000011; these lines are not used" in done.stderr


def test_corners_as_fractions_are_refused_at_once(folder, tmp_path):
    rows = "".join(f"{k},0.1,0.1,0.9,0.1,0.9,0.9,0.1,0.9\n" for k in range(6))
    (tmp_path / "c.csv").write_text("image,x1,y1,x2,y2,x3,y3,x4,y4\n" + rows)
    done = run("segment", folder, *DISCS, "--quadrat", 0.5, "--corners", "c.csv")
    assert_one_line(done, "c.csv: 0: expected corners in px of the upright image, got fractions of its size")


def result(method):
    return ResultRecord(
        track="detection",
        split="",
        sequence="mine",
        method=method,
        metrics={"count_truth": 20.0, "count_estimate": 18.0},
    )


def test_a_picture_without_corners_is_not_counted_and_told_of(folder, tmp_path):
    (tmp_path / "c.csv").write_text("image,x1,y1,x2,y2,x3,y3,x4,y4\n0,70,20,130,20,130,110,70,110\n")
    done = run("segment", folder, *DISCS, "--quadrat", 0.5, "--corners", "c.csv")
    assert done.returncode == 1
    assert "1: c.csv has no corners for it, so it was not counted" in done.stderr
    with open("Fotos ü-oysters/images.csv", newline="", encoding="utf-8") as file:
        assert [bool(row["failure"]) for row in csv.DictReader(file)] == [False] + [True] * 5


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (("--mm-per-px", "-1"), 2, "--mm-per-px: expected millimetres above 0, got -1"),
        (("--method", "tests.helpers.image_methods:Small"), 1, "expected a prediction of the image's size"),
        (("--method", "straight"), 1, "expected a method of detection or segmentation, got one of steering"),
        (("--method", "nonsense"), 1, "unknown method 'nonsense'"),
        (("--checked", "gone.json"), 1, "gone.json: no such file; expected results of discs: `oysterbench run"),
    ],
)
def test_what_cannot_be_done_is_one_line(folder, options, code, said):
    options = options if "--method" in options else (*DISCS, *options)
    assert_one_line(run("segment", folder, *options), said, code)


def test_a_method_without_weights_says_what_to_type(folder, tmp_path, monkeypatch):
    monkeypatch.setenv("OYSTERBENCH_MODELS", str(tmp_path / "models"))
    done = run("segment", folder, "--method", "unet_small_instances", home=tmp_path / "home")
    assert_one_line(done, "no trained weights at .*oysterbench train unet_small")


def test_an_empty_folder_is_one_line(tmp_path):
    assert_one_line(run("segment", tmp_path), "expected images .* got an empty folder")


@pytest.mark.parametrize("option", ["--threshold", "--min-mm", "--min-px", "--rate", "--quadrat"])
@pytest.mark.parametrize("value", ["nan", "inf"])
def test_what_is_no_number_is_refused_before_anything_is_counted(folder, tmp_path, option, value):
    done = run("segment", folder, *DISCS, "--out", "out", option, value)
    assert done.returncode == 2
    assert option in done.stderr
    assert not (tmp_path / "out").exists()
