"""Which warnings stand about settings."""

from gateway.config import VisionConfig
from gateway.vision.detect.method import Remark
from gateway.web.tuning.standing_warnings import KEPT_SETTINGS, MAX_ID, WarningStore, covers, warning_id

TRIED = VisionConfig(method="paper")
SLOW = Remark("slower than the camera: 80 ms a frame here, a frame every 50 ms; frames will be skipped")


def texts(store: WarningStore, settings: VisionConfig = TRIED, bay: str = "a") -> list[str]:
    return [warning.text for warning in store.of(bay, settings, ["s1", "r2"])]


def test_a_look_at_one_frame_does_not_replace_what_the_whole_recording_showed() -> None:
    store = WarningStore()
    store.note("a", TRIED, "r2", [SLOW])
    store.note("a", TRIED, "r2", [], complete=False)
    assert texts(store) == [SLOW.text]
    assert (texts(store, bay="b"), texts(store, VisionConfig())) == ([], [])
    store.note("a", TRIED, "r2", [])
    assert texts(store) == []


def test_one_kind_of_warning_stands_once_and_names_its_pictures() -> None:
    store = WarningStore()
    store.note("a", TRIED, "live", [Remark("lets in 47 %", "red_low_1"), Remark("no effect", warning=False)])
    store.note("a", TRIED, "s1", [Remark("lets in 46.5 %", "red_low_1")])
    store.note("a", TRIED, "s0", [SLOW])  # a picture that is not kept any more
    (one,) = store.of("a", TRIED, ["s1"])
    assert (one.id, one.text, one.pictures) == ("red_low_1: lets in # % [46.5]", "lets in 46.5 %", ("live", "s1"))


def test_one_kind_of_warning_stands_twice_where_a_picture_shows_it_far_worse() -> None:
    store = WarningStore()
    store.note("a", TRIED, "r2", [Remark("less often: in 90 % of the frames, in force 100 %")])
    store.note("a", TRIED, "s1", [Remark("less often: in 0 % of the frames, in force 100 %")])
    first, second = store.of("a", TRIED, ["r2", "s1"])
    assert [(one.text[15:19], one.pictures) for one in (first, second)] == [("90 %", ("r2",)), ("0 % ", ("s1",))]


def test_what_was_accepted_covers_figures_that_differ_a_little() -> None:
    accepted = warning_id("test set bay1/dusk 1: missed", "missed in 20 of 100 pictures")
    assert accepted == "test set bay1/dusk 1: missed [20 100]"
    for kind, text, covered in (
        ("test set bay1/dusk 1: missed", "missed in 26 of 100 pictures", True),
        ("test set bay1/dusk 1: missed", "missed in 27 of 100 pictures", False),
        ("test set bay1/dusk 1: missed", "missed in 100 of 100 pictures", False),
        ("test set bay1/dusk 1: missed", "missed in 0 of 100 pictures", False),
        ("test set bay1/dusk 1: missed", "missed", False),
        ("test set bay1/dusk 1: worse", "missed in 20 of 100 pictures", False),
        ("test set bay1/dusk 2: missed", "missed in 20 of 100 pictures", False),
    ):
        assert covers(accepted, warning_id(kind, text)) == covered, text
    for strange in ("", "[", "test set bay1/dusk 1: missed", "test set bay1/dusk 1: missed [1e999 x]"):
        assert not covers(strange, accepted)
    assert covers("red_low_1: cuts the marker []", warning_id("red_low_1: cuts the marker", "cuts the marker"))
    assert len(warning_id("x" * 500, "1 " * 500)) <= MAX_ID


def test_only_so_many_settings_are_kept() -> None:
    store = WarningStore()
    for n in range(KEPT_SETTINGS + 1):
        store.note("a", VisionConfig(coast_s=n / 1000), "s1", [SLOW])
    assert texts(store, VisionConfig(coast_s=0)) == []
    assert texts(store, VisionConfig(coast_s=0.001)) == [SLOW.text]
