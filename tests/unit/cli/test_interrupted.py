"""Ctrl-C while modules are imported, and of which a library makes another error."""

import subprocess
import sys
from pathlib import Path

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


def test_nothing_slow_is_imported_before_ctrl_c_is_kept() -> None:
    """Until then it ends in Python's own traceback."""
    code = f"import sys; sys.path.insert(0, {str(Path(__file__).parents[3])!r}); import gateway.__main__; "
    code += "print({'enum', 'signal'} & {*sys.modules})"
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout == "set()\n"
