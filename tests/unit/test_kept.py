"""What is kept for the next run is what its sources make."""

from pathlib import Path

import pytest

from tests import kept


@pytest.fixture(autouse=True)
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setattr(kept, "KEPT", tmp_path / "kept")
    return tmp_path / "kept"


def test_it_is_made_once_from_the_same_sources_and_anew_from_others() -> None:
    made: list[str] = []

    def text(*sources: bytes) -> str:
        def make(file: Path) -> None:
            made.append(f"{len(made)}")
            file.write_text(made[-1])

        return kept.made_once("number", make, *sources).read_text()

    assert [text(b"a", b"bc"), text(b"a", b"bc"), text(b"ab", b"c"), text(b"a"), text(b"a", b"bc")] == list("00120")


def test_what_was_not_made_to_its_end_is_not_kept(folder: Path) -> None:
    def half(file: Path) -> None:
        file.write_text("hal")
        raise ValueError("half")

    for _ in range(2):
        with pytest.raises(ValueError, match="half"):
            kept.made_once("text", half, b"a")
    assert kept.made_once("text", lambda file: file.write_text("whole"), b"a").read_text() == "whole"
    assert not list(folder.glob("*.fresh"))
