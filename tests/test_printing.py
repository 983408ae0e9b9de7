import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie.errors import BaggieError, DataError
from baggie.sim.printed import texture
from baggie.vision.printing import draw_goal_card, draw_target, print_goal_card, print_target
from baggie.vision.targets import ArucoMarker, Charuco, Chessboard, parse_target, pattern
from helpers.printed_pages import page_picture, page_words

DPI = 150
BOARD = parse_target("charuco:7x5:0.030:0.021:DICT_4X4_50")
TARGETS = [
    BOARD,
    Chessboard(8, 5, 0.025),
    ArucoMarker("DICT_5X5_100", 7, 0.1),
    Charuco(4, 6, 0.03, 0.02, "DICT_4X4_50", True),
]


def millimetres(pixels: np.ndarray, dpi: int = DPI) -> np.ndarray:
    return pixels / dpi * 25.4


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("grid", [(7, 5), (6, 4), (5, 6)])
def test_a_board_is_what_opencv_draws(grid: tuple[int, int], legacy: bool) -> None:
    board = Charuco(*grid, 0.03, 0.018, "DICT_4X4_50", legacy)
    size = (30 * grid[0], 30 * grid[1])  # a module is 3 pixels
    ours = texture(board, (0.03 * grid[0], 0.03 * grid[1]), size[::-1])
    np.testing.assert_array_equal(ours[..., 0] > 127, board.board.generateImage(size) > 127)


@given(st.sampled_from(["DICT_4X4_50", "DICT_6X6_250", "DICT_APRILTAG_36h11"]), st.integers(0, 49))
@settings(deadline=None, max_examples=10)
def test_a_marker_is_what_opencv_draws(dictionary: str, number: int) -> None:
    marker = ArucoMarker(dictionary, number, 0.08)
    theirs = cv2.aruco.generateImageMarker(
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)), number, 240
    )
    np.testing.assert_array_equal(texture(marker, (0.08, 0.08), (240, 240))[..., 0] > 127, theirs > 127)


@given(st.integers(2, 8), st.integers(2, 8), st.booleans())
@settings(deadline=None, max_examples=10)
def test_no_black_lies_on_black_or_outside(columns: int, rows: int, legacy: bool) -> None:
    drawing = pattern(Charuco(columns, rows, 0.02, 0.013, "DICT_5X5_50", legacy))
    left, top, right, bottom = drawing.black.T
    assert (drawing.black[:, :2] >= drawing.bounds[:2] - 1e-9).all()
    assert (drawing.black[:, 2:] <= drawing.bounds[2:] + 1e-9).all()
    across = np.minimum.outer(right, right) - np.maximum.outer(left, left)
    down = np.minimum.outer(bottom, bottom) - np.maximum.outer(top, top)
    shared = np.maximum(across, 0) * np.maximum(down, 0)
    np.fill_diagonal(shared, 0)
    assert shared.max() < 1e-9


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.spec)
def test_a_printed_target_is_found_the_right_way_up_at_true_size(
    target: Charuco | Chessboard | ArucoMarker,
) -> None:
    seen = target.detect(page_picture(draw_target(target), DPI))
    assert seen is not None
    assert len(seen.ids) == len(target.points)
    found, wanted = millimetres(seen.pixels), 1000 * seen.points[:, :2]
    np.testing.assert_allclose(found - found.mean(axis=0), wanted - wanted.mean(axis=0), atol=0.1)


@pytest.mark.parametrize("turns", range(4))
@pytest.mark.parametrize("quick", [False, True])
def test_a_chessboard_is_counted_from_the_same_end_however_it_lies_and_is_found(
    quick: bool, turns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    if quick:
        monkeypatch.setattr("cv2.findChessboardCornersSB", lambda *words, **more: (False, None))
    board = Chessboard(8, 5, 0.03)
    picture = texture(board, (0.36, 0.27), (270, 360))
    seen = board.detect(np.ascontiguousarray(np.rot90(picture, turns)))
    assert seen is not None
    first = np.array([(0.36 - 0.21) / 2, (0.27 - 0.12) / 2]) * 1000 - 0.5  # of the upright picture
    for _ in range(turns):
        picture, first = np.rot90(picture), np.array([first[1], picture.shape[1] - 1 - first[0]])
    np.testing.assert_allclose(seen.pixels[0], first, atol=0.2)


@pytest.mark.parametrize("paper", ["A4", "A3"])
def test_the_ruler_is_100_mm_long(paper: str) -> None:
    grey = page_picture(draw_target(BOARD, paper), DPI).min(axis=2)
    footer = grey[-int(20 / 25.4 * DPI) :] < 128
    longest = max(
        (len(run) for row in footer for run in "".join("#" if dark else " " for dark in row).split()),
        default=0,
    )
    assert millimetres(np.array(longest)) == pytest.approx(
        100.0, abs=0.25
    )  # the end ticks' own width is 0.14 mm


@pytest.mark.parametrize(
    ("target", "paper", "size_mm"),
    [
        (BOARD, "A4", (297, 210)),
        (BOARD, "A3", (420, 297)),
        (Chessboard(5, 8, 0.02), "A4", (210, 297)),
        (ArucoMarker("DICT_4X4_50", 0, 0.15), "A4", (210, 297)),
    ],
)
def test_the_page_is_the_paper_lying_as_the_target_fits(
    target: Charuco, paper: str, size_mm: tuple[float, float], tmp_path: Path
) -> None:
    path = tmp_path / "new" / "target.pdf"
    print_target(target, path, paper)
    content = path.read_bytes()
    box = re.search(rb"/MediaBox \[ *([\d. ]+?) *\]", content)
    assert box is not None
    points = np.array([float(number) for number in box[1].split()])
    np.testing.assert_allclose(points / 72 * 25.4, [0, 0, *size_mm], atol=0.01)
    assert b"/Subtype /Image" not in content, "vectors, no pixels"
    assert b"/Filter /DCTDecode" not in content
    print_target(target, tmp_path / "again.pdf", paper)
    assert (tmp_path / "again.pdf").read_bytes() == content


def test_a_page_says_what_is_on_it_and_how_to_print_it() -> None:
    pages = {
        "charuco:7x5:0.03:0.021:DICT_4X4_50 7 x 5 squares of 30 mm, markers of 21 mm": draw_target(BOARD),
        "charuco:4x6:0.03:0.02:DICT_4X4_50, legacy layout": draw_target(TARGETS[3]),
        "goal card 130 mm solid square, RGB 1 2 3; cut": draw_goal_card(0.13, (1, 2, 3), "A4", "solid"),
    }
    for words, page in pages.items():
        said = page_words(page)
        for each in (words, "Print at 100 %, then measure the ruler.", "80 90 100 mm"):
            assert each in said


@pytest.mark.parametrize("style", ["solid", "outline"])
def test_a_goal_card_has_its_size_and_colour(style: str) -> None:
    color = (26, 140, 51)
    dpi = 2 * DPI  # a page is drawn on whole pixels: a card on it up to one larger
    page = page_picture(draw_goal_card(0.13, color, "A4", style), dpi)  # type: ignore[arg-type]
    v, u = np.nonzero((page[..., 0] < 140) & (np.ptp(page, axis=2) > 50))  # more colour than paper
    np.testing.assert_allclose(millimetres(np.array([np.ptp(u) + 1, np.ptp(v) + 1]), dpi), 130.0, atol=0.2)
    middle = page[(v.min() + v.max()) // 2, (u.min() + u.max()) // 2]
    np.testing.assert_array_equal(middle, color if style == "solid" else (255, 255, 255))


def test_what_does_not_fit_names_the_paper_that_does(tmp_path: Path) -> None:
    wide = parse_target("charuco:9x6:0.040:0.030:DICT_5X5_100")
    with pytest.raises(BaggieError, match=r"360 x 240 mm and does not fit A4 .*print it on A3"):
        print_target(wide, tmp_path / "board.pdf")
    print_target(wide, tmp_path / "board.pdf", "A3")
    with pytest.raises(BaggieError, match="make it smaller"):
        print_target(Chessboard(9, 6, 0.05), tmp_path / "huge.pdf", "A3")
    assert not (tmp_path / "huge.pdf").exists()
    with pytest.raises(BaggieError, match="print it on A3"):
        print_goal_card(tmp_path / "card.pdf", 0.25)


def test_nonsense_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "x.pdf"
    with pytest.raises(BaggieError, match="expected paper A4 or A3, got 'Letter'"):
        print_target(BOARD, path, "Letter")
    with pytest.raises(BaggieError, match="metres"):
        print_goal_card(path, 130.0)
    with pytest.raises(BaggieError, match="take a larger dictionary"):
        print_target(Charuco(14, 10, 0.01, 0.007, "DICT_4X4_50"), path)
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot be written"):
        print_target(BOARD, tmp_path / "file" / "board.pdf")
