"""A backup of a gateway that runs, and why it is not restored under it."""

from pathlib import Path

import pytest

from tests.e2e.plc import Plc
from tests.e2e.processes import Gateway, command
from tests.e2e.sim_ranger import Ranger
from tests.e2e.test_reload import until
from tests.e2e.test_run import config_file, port_of, ranger, video

__all__ = ["ranger", "video"]  # fixtures


def recorded(folder: Path) -> int:
    """Bytes of the segments."""
    return sum(file.stat().st_size for file in folder.glob("*.seg"))


@pytest.mark.long
def test_a_gateway_is_backed_up_while_it_runs_and_restored_where_it_does_not(
    tmp_path: Path, video: Path, ranger: Ranger, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "state"))
    config, archive = config_file(tmp_path, video, ranger.port), tmp_path / "bay.tar.gz"
    text = config.read_text()
    with Gateway("run", str(config)) as gateway, Plc(port_of(gateway)) as plc:
        plc.wait_for(lambda image: image["may_move"] == 1)
        recording = tmp_path / "state" / "records" / f"test.{tmp_path.name}" / "bay1"
        until(lambda: recorded(recording) > 0)
        done = command("backup", str(archive), "--config", str(config), "--records")
        assert (done.code, done.err) == (0, "")
        assert [line.split()[0] for line in done.out.splitlines()][:4] == ["configuration", "state", "state", "record"]
        kept = recorded(recording)
        until(lambda: recorded(recording) > kept)  # it goes on
        config.write_text("# another\n")
        refused = command("restore", str(archive), "--force", "--outside")
        assert (refused.code, config.read_text()) == (2, "# another\n")
        assert "has recordings of its own" in refused.err
        (tmp_path / "state" / "records").rename(tmp_path / "recorded")
        refused = command("restore", str(archive), "--force", "--outside")
        assert (refused.code, config.read_text()) == (2, "# another\n")
        assert "is already running" in refused.err
        assert gateway.end() == 0
    done = command("restore", str(archive), "--force", "--outside")
    assert (done.code, done.err, config.read_text()) == (0, "", text)
    replayed = command("replay", str(tmp_path / "state" / "records" / f"test.{tmp_path.name}" / "bay1"))
    assert replayed.code == 0, replayed
