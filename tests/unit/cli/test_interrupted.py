"""Ctrl-C of which a library makes another error."""

import pytest

from gateway import cli, interrupts
from gateway.__main__ import main


@pytest.mark.parametrize("asked", [True, False])
def test_what_a_library_makes_of_ctrl_c_is_its_end_and_another_error_stays_one(
    monkeypatch: pytest.MonkeyPatch, *, asked: bool
) -> None:
    def verbs() -> int:
        raise RuntimeError("Error building `literal` serializer:\n  KeyboardInterrupt: ")

    monkeypatch.setattr(interrupts, "keep", lambda: None)
    monkeypatch.setattr(interrupts, "asked", lambda: asked)
    monkeypatch.setattr(cli, "main", verbs)
    if asked:
        assert main() == 130
    else:
        with pytest.raises(RuntimeError):
            main()
