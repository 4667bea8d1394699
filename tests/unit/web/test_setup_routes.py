"""The settings page's addresses against a real main process's side and a real file."""

import asyncio
import gzip
import json
import logging
import tomllib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from argon2 import PasswordHasher
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway import config
from gateway.config import GatewayConfig
from gateway.core.detection import Circle
from gateway.core.readings import Quality, RangeReading, VisionReading
from gateway.core.state import FunctionCheck, VisitPhase
from gateway.web.host.startup import Restart, Startup
from tests.examples import examples
from tests.unit.web.asgi import Answer
from tests.unit.web.gateway_client import Plant, plant
from tests.unit.web.programs import ANNA, ApiClient, api_client
from tests.unit.web.tuning import picture
from tests.virtual_time import in_real_time, in_virtual_time, run

HASH = "$argon2id$v=19$m=19456,t=1,p=1$c29tZXNhbHRzb21lc2FsdA$W+2f2aTQVuXP2kOFsVBogWmXqhlPdId3xAJac1/d60o"
FILE = f"""\
# The plant's file.
site = "plant1"

[hmi]
enabled = true
[[hmi.users]]
name = "anna"
role = "technician"
password_hash = "{HASH}"

[mqtt]
url = "mqtt://gateway:s3cret@broker"  # old password: s3cret

[sinks.postgresql]
url = "postgresql://me:s3cret@db/loading"

[[bays]]
name = "A"     # the first
camera.url = "rtsp://me:s3cret@cam/1?token=s3cret"

[[bays]]
name = "B"
unit_id = 2
camera.url = "1"
ranger.port = "/dev/ttyACM1"
"""
NEW = "truck stands under a spout"
SECRETS = ("s3cret", "c29tZXNhbHRzb21lc2FsdA", "W+2f2aTQVuXP2k")


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the bay files."""
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "state"))
    return tmp_path / "state"


def checks(state: Path) -> dict[str, str]:
    """By bay file, its function check."""
    return {path.name: json.loads(path.read_text())["function_check"] for path in state.iterdir()}


@dataclass
class Page:
    """The page's requests about one file."""

    made: Plant
    api_client: ApiClient
    path: Path
    restart: Restart

    async def settings(self) -> Any:
        return (await self.api_client.get("/api/setup/settings")).json

    async def post(self, name: str, *changes: tuple[str, Any], **more: Any) -> Answer:
        listed = [{"path": path.split("."), "value": value} for path, value in changes]
        body = {"digest": (await self.settings())["digest"], "changes": listed, **more}
        return await self.api_client.post(f"/api/setup/{name}", body)


def write(path: Path, text: str) -> None:
    path.write_text(text)


@asynccontextmanager
async def page(path: Path, text: str = FILE, overrides: dict[str, Any] | None = None) -> AsyncIterator[Page]:
    write(path, text)
    restart = Restart(asyncio.Event())
    startup = Startup(overrides or {}, restart, warnings=lambda found: [f"site {found.site} is odd"])
    async with plant(config=config.load(path, overrides), source=str(path), startup=startup) as made:
        yield Page(made, api_client(made), path, restart)


@pytest.mark.one_interpreter
@in_virtual_time
async def test_the_file_is_shown_with_its_schema_and_without_its_passwords(tmp_path: Path) -> None:
    async with page(tmp_path / "plant.toml") as asked:
        answer = await asked.api_client.get("/api/setup/settings")
        found = answer.json
        assert [secret for secret in SECRETS if secret in answer.text] == []
        assert found["file"] == str(asked.path)
        assert (found["why_not"], found["faults"], found["waiting"], found["undo"]) == ("", [], [], False)
        assert found["written"]["bays"]["A"] == {"name": "A", "camera": {"url": "rtsp://***@cam/1?token=***"}}
        assert found["written"]["hmi"]["users"]["anna"]["password_hash"] == "***"
        assert found["written"]["sinks"]["postgresql"] == {"url": "postgresql://***@db/loading"}
        assert found["values"]["mqtt"]["url"] == "mqtt://***@broker"
        assert found["values"]["bays"]["B"]["fusion"]["radius_threshold_px"] == 180
        assert found["values"]["sinks"]["postgresql"]["outbox_mb"] == 64
        assert found["values"]["modbus"]["port"] == 502
        assert found["values"]["drive"] is None
        port = found["json_schema"]["$defs"]["ModbusConfig"]["properties"]["port"]
        assert port == {"default": 502, "description": "0 picks a free one", "maximum": 65535, "minimum": 0,
                        "type": "integer"}  # fmt: skip
        jsonschema.Draft202012Validator.check_schema(found["json_schema"])


@in_virtual_time
async def test_what_is_long_and_holds_no_secret_comes_compressed_and_languages_once(tmp_path: Path) -> None:
    async with page(tmp_path / "plant.toml") as asked:
        get = asked.api_client.get
        for path in ("/api/setup/settings", "/api/languages/de"):
            plain, short = await get(path), await get(path, {"accept-encoding": "gzip"})
            assert short.headers["content-encoding"] == "gzip"
            assert gzip.decompress(short.body) == plain.body
            assert len(short.body) < len(plain.body) / 2
        assert "content-encoding" not in (await get("/api/session", {"accept-encoding": "gzip"})).headers
        again = await get("/api/languages/de", {"if-none-match": short.headers["etag"]})
        assert (again.status, again.body) == (304, b"")


def test_the_schema_takes_what_the_gateway_takes_and_names_unit_secret_and_choices(tmp_path: Path) -> None:
    async def schema() -> Any:
        async with page(tmp_path / "plant.toml") as asked:
            return (await asked.settings())["json_schema"]

    found = run(schema())
    shipped = Path(__file__).parents[3] / "config"
    for name in ("gateway.toml", "four-bays.toml", "simulate.toml"):
        jsonschema.Draft202012Validator(found).validate(tomllib.loads((shipped / name).read_text()))
    parts = found["$defs"]
    assert parts["FusionConfig"]["properties"]["distance_threshold_mm"]["x-unit"] == "mm"
    assert parts["DriveConfig"]["properties"]["jerk_mm_s3"]["x-unit"] == "mm/s³"
    assert parts["HmiUser"]["properties"]["password_hash"]["x-secret"] is True
    assert parts["VisionConfig"]["properties"]["method"]["enum"] == ["robust", "paper"]
    assert found["properties"]["recipes"]["x-named-by"] == "id"
    assert "PostgresqlConfig" in parts
    undescribed = [
        f"{name}.{key}"
        for name, part in {**parts, "top": found}.items()
        for key, one in part["properties"].items()
        if "description" not in one and "$ref" not in str(one) and name != "Sinks"
    ]
    assert undescribed == []


@pytest.mark.one_interpreter
@in_virtual_time
async def test_changes_are_previewed_saved_and_undone(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    async with page(tmp_path / "plant.toml") as asked:
        changes = (("modbus.port", 5020), ("bays.B.vision.method", "paper"), ("site", "plant2"))
        seen = (await asked.post("preview", *changes)).json
        assert seen["faults"] == []
        assert {'-site = "plant1"', '+site = "plant2"', "+port = 5020", '+vision.method = "paper"'} <= set(
            seen["diff"].splitlines()
        )
        assert seen["warnings"] == ["site plant2 is odd"]
        assert set(seen["restart"]) == {
            'site: "plant1" -> "plant2"',
            "modbus.port: 502 -> 5020",
            'bays.B.vision.method: "robust" -> "paper"',
        }
        assert asked.path.read_text() == FILE

        saved = (await asked.post("save", *changes)).json
        assert saved["previous"] == f"{asked.path}.previous"
        assert asked.path.with_name("plant.toml.previous").read_text() == FILE
        assert config.load(asked.path).modbus.port == 5020
        assert "# the first" in asked.path.read_text()
        assert "modbus.port, bays.B.vision.method, site saved by 10.0.0.7 (anna, role technician)" in caplog.text
        now = await asked.settings()
        assert now["digest"] == saved["digest"]
        assert now["undo"] is True
        assert len(now["waiting"]) == 3

        undo = (await asked.post("preview", undo=True)).json
        assert '+site = "plant1"' in undo["diff"].splitlines()
        assert (await asked.post("save", undo=True)).status == 200
        assert asked.path.read_text() == FILE
        assert (await asked.settings())["waiting"] == []


@pytest.mark.one_interpreter
@in_virtual_time
async def test_faults_come_back_with_path_line_and_message_and_prevent_saving(tmp_path: Path) -> None:
    async with page(tmp_path / "plant.toml") as asked:
        changes = (("bays.B.unit_id", 1), ("bays.B.camera.url", "nonsense://x"), ("modbus.port", 70000))
        seen = (await asked.post("preview", *changes)).json
        assert seen["faults"] == [
            {"path": ["modbus", "port"], "line": len(FILE.splitlines()) + 3,
             "message": "70000: Input should be less than or equal to 65535 (allowed: >= 0, <= 65535)"},
        ]  # fmt: skip
        refused = await asked.post("save", *changes)
        assert refused.status == 422
        assert "modbus.port: 70000" in refused.json["detail"]
        (same,) = (await asked.post("preview", *changes[:1])).json["faults"]
        assert (same["path"], same["line"]) == (["bays", "B", "unit_id"], 23)
        (camera,) = (await asked.post("preview", changes[1])).json["faults"]  # found by the gateway's own checks
        assert camera["path"] == ["bays", "B", "camera", "url"]
        (gone,) = (await asked.post("preview", ("bays.C.unit_id", 3))).json["faults"]
        assert gone == {"path": ["bays", "C", "unit_id"], "line": None,
                        "message": "bays: there is no C; there is: A, B"}  # fmt: skip
        assert asked.path.read_text() == FILE


@in_virtual_time
async def test_a_bay_is_added_under_a_function_check_and_removed(tmp_path: Path, state: Path) -> None:
    async with page(tmp_path / "plant.toml") as asked:
        new = {"unit_id": 3, "camera": {"url": "2"}, "ranger": {"port": "/dev/ttyACM2"}}
        assert (await asked.post("save", ("bays.C", new))).status == 200
        assert [bay.name for bay in config.load(asked.path).bays] == ["A", "B", "C"]
        assert checks(state) == {"bay.plant1.gateway.C.json": "MAY_MOVE_OFF"}  # none of those that run
        assert (await asked.post("save", ("bays.C", None), ("bays.B", None))).status == 200
        assert [bay.name for bay in config.load(asked.path).bays] == ["A"]


@in_virtual_time
async def test_a_bay_whose_function_check_can_not_be_kept_is_not_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with page(tmp_path / "plant.toml") as asked:
        monkeypatch.setenv("STATE_DIRECTORY", str(asked.path))  # no folder
        refused = await asked.post("save", ("bays.C", {"unit_id": 3, "camera": {"url": "2"}, "ranger": {"port": "x"}}))
        assert (refused.status, "C's function check can't be kept" in refused.json["detail"]) == (422, True)
        assert asked.path.read_text() == FILE


@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_password_is_replaced_but_never_kept_for_another_address(tmp_path: Path) -> None:
    async with page(tmp_path / "plant.toml") as asked:
        assert (await asked.post("preview", ("mqtt.url", "mqtt://***@broker"))).json["diff"] == ""  # as it was
        (fault,) = (await asked.post("preview", ("mqtt.url", "mqtt://***@elsewhere"))).json["faults"]
        assert "write the complete value" in fault["message"]
        answer = await asked.post("preview", ("mqtt.url", "mqtt://g:n3w@elsewhere"))
        assert answer.json["faults"] == []
        assert '+url = "mqtt://***@elsewhere"' in answer.json["diff"]
        assert "n3w" not in answer.text
        await asked.post("save", ("mqtt.url", "mqtt://g:n3w@elsewhere"), ("hmi.users.anna.password_hash", HASH))
        assert 'url = "mqtt://g:n3w@elsewhere"  # old' in asked.path.read_text()
        (bad,) = (await asked.post("preview", ("hmi.users.anna.password_hash", "s3cret"))).json["faults"]
        assert "s3cret" not in str(bad)


async def typed(asked: Page, user: str, password: str) -> Answer:
    return await asked.api_client.post("/api/setup/password", {"name": user, "password": password})


@in_real_time
async def test_users_are_made_by_name_and_password_and_no_hash_reaches_the_page(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """In real time: a thread makes the hash."""
    caplog.set_level(logging.DEBUG)
    async with page(tmp_path / "plant.toml") as asked:
        weak = await typed(asked, "vera", "vera98321!")
        assert (weak.status, weak.json["detail"]) == (
            400,
            "this password is little more than 'vera', which is tried first",
        )
        answer = await typed(asked, "vera", NEW)
        name = answer.json["password_hash"]
        assert "argon2" not in answer.text
        new = ("hmi.users.vera", {"role": "viewer"}), ("hmi.users.vera.password_hash", name)
        seen = await asked.post("preview", *new)
        assert seen.json["faults"] == []
        assert '+password_hash = "***"' in seen.json["diff"].splitlines()
        assert (await asked.post("save", *new)).status == 200
        (anna, vera) = config.load(asked.path).hmi.users
        assert (vera.name, vera.role, anna.password_hash) == ("vera", "viewer", HASH)
        assert PasswordHasher().verify(vera.password_hash, NEW)
        assert vera.password_hash.startswith("$argon2id$v=19$m=19456,t=2,p=1$")

        assert (await asked.post("save", ("hmi.users.anna.password_hash", name))).json["error"] == "password"  # vera's
        again = ("hmi.users.vera.password_hash", (await typed(asked, "vera", f"{NEW} 2")).json["password_hash"])
        seen = await asked.post("preview", again)  # both are masked, and it is a change all the same
        assert (seen.json["diff"], [*seen.json["live"], *seen.json["restart"]]) == (
            "",
            ['hmi.users.vera.password_hash: "***" -> "***"'],
        )
        asked.api_client.caller = replace(ANNA, csrf="of another login")
        assert (await asked.post("save", again)).status == 409
        asked.api_client.caller = ANNA
        assert (await asked.post("save", again, ("hmi.users.vera.role", "technician"))).status == 200
        assert (await asked.post("save", undo=True)).status == 200
        (_, vera) = config.load(asked.path).hmi.users
        assert PasswordHasher().verify(vera.password_hash, NEW)
        assert [text for text in (NEW, name, "argon2") if text in caplog.text] == []
        assert "hmi.users.vera, hmi.users.vera.password_hash saved by 10.0.0.7 (anna, role technician)" in caplog.text
        statuses = [(await typed(asked, "vera", f"{NEW} {n}")).status for n in range(10)]
        assert statuses == [200] * 8 + [429] * 2  # as many at once as a login may fail


@in_virtual_time
async def test_nobody_is_locked_out_silently(tmp_path: Path) -> None:
    async with page(tmp_path / "plant.toml") as asked:
        for change in (("hmi.users.anna", None), ("hmi.users.anna.role", "viewer")):
            (fault,) = (await asked.post("preview", change)).json["faults"]
            assert fault["path"] == ["hmi", "users"]
            assert fault["message"].startswith("no technician would be left, and nobody could open this page")
            assert (await asked.post("save", change)).status == 422
        assert asked.path.read_text() == FILE
        tom = {"role": "technician", "password_hash": HASH}
        assert (await asked.post("save", ("hmi.users.tom", tom), ("hmi.users.anna.role", "viewer"))).status == 200
        await asked.post("save", undo=True)
        seen = (await asked.post("preview", ("hmi.users.tom", tom), ("hmi.users.anna", None))).json
        assert (seen["faults"], seen["warnings"][1:]) == (
            [],
            ["hmi.users: anna, who is you, is no technician then: only others can open this page afterwards"],
        )
        await asyncio.sleep(10)  # requests for the file are limited
        await asked.post("save", ("hmi.users.tom", tom))
        assert len((await asked.post("preview", ("hmi.users.tom", None))).json["warnings"]) == 1  # of somebody else
        await asked.post("save", ("hmi.users.anna", None))
        write(asked.path.with_name("plant.toml.previous"), FILE.replace('role = "technician"', 'role = "viewer"'))
        assert (await asked.post("save", undo=True)).status == 422


@in_virtual_time
async def test_two_editors_do_not_overwrite_each_other(tmp_path: Path) -> None:
    async with page(tmp_path / "plant.toml") as asked:
        before = (await asked.settings())["digest"]
        asked.path.write_text(FILE.replace("plant1", "plant9"))
        for name in ("preview", "save"):
            late = await asked.post(name, ("site", "mine"), digest=before)
            assert (late.status, late.json["error"]) == (409, "changed")
            assert "was changed elsewhere since it was shown; nothing was written" in late.json["detail"]
        assert "plant9" in asked.path.read_text()


@in_virtual_time
async def test_why_nothing_can_be_saved_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    async with page(path, overrides={"modbus": {"port": 5020}}) as asked:
        found = await asked.settings()
        assert found["command_line"] == [["modbus", "port"]]
        assert found["values"]["modbus"]["port"] == 5020
        (fault,) = (await asked.post("preview", ("modbus.port", 502))).json["faults"]
        assert fault["message"] == "is set on the command line, whatever the file says"
        path.chmod(0o444)
        assert "is read-only for the gateway" in (await asked.settings())["why_not"]
        assert "is read-only for the gateway" in (await asked.post("save", ("site", "x"))).json["detail"]
        path.chmod(0o644)
        path.write_text("site = 3\n")
        found = await asked.settings()
        assert (found["values"], found["faults"][0]["path"], found["faults"][0]["line"]) == (None, ["site"], 1)
        assert (await asked.post("save", ("site", "mended"))).status == 200
    async with plant(config=GatewayConfig()) as made:
        assert "no file of yours" in (await api_client(made).get("/api/setup/settings")).json["detail"]
    off = FILE.replace("enabled = true", "enabled = true\nsetup_page = false")
    async with page(path, off) as asked:
        assert "hmi.setup_page = false" in (await asked.api_client.get("/api/setup/settings")).json["detail"]


@in_virtual_time
async def test_a_password_of_this_machine_is_not_sent_to_an_address_typed_on_the_page(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("s3cret\n")
    broker = f'[mqtt]\nurl = "mqtt://broker"\npassword_file = "{secret}"\nusername = "gateway"\n'
    text = FILE.replace('[mqtt]\nurl = "mqtt://gateway:s3cret@broker"  # old password: s3cret\n', broker)
    async with page(tmp_path / "plant.toml", text) as asked:
        refused = await asked.post("save", ("mqtt.url", "mqtt://evil"))
        assert refused.status == 422
        assert refused.json["detail"].startswith("mqtt.url: the password that password_file names would be sent to ano")
        assert asked.path.read_text() == text
        (fault,) = (await asked.post("preview", ("mqtt.url", "mqtt://evil"))).json["faults"]
        assert fault["path"] == ["mqtt", "url"]
        gone = [("mqtt.password_file", None), ("mqtt.username", None)]
        assert (await asked.post("save", ("mqtt.url", "mqtt://me:typed@new"), *gone)).status == 200
        assert (await asked.post("save", ("mqtt.password_file", str(secret)))).status == 422
        assert (await asked.post("save", undo=True)).status == 200
        assert asked.path.read_text() == text


@in_virtual_time
async def test_bays_of_the_command_line_leave_the_files_alone(tmp_path: Path) -> None:
    """As `gateway simulate --bays 3` has them: on one camera and one port, which nobody opens."""
    one = FILE[: FILE.index('[[bays]]\nname = "B"')].replace('name = "A"', 'name = "north"')
    bays = [{"name": f"bay{n}", "unit_id": n} for n in (1, 2, 3)]
    async with page(tmp_path / "plant.toml", one, overrides={"bays": bays}) as asked:
        found = await asked.settings()
        assert (found["faults"], found["waiting"], found["command_line"]) == ([], [], [["bays"]])
        assert list(found["values"]["bays"]) == list(found["written"]["bays"]) == ["north"]
        assert asked.made.client.bays == ("bay1", "bay2", "bay3")
        for path in ("bays.bay1.camera.url", "bays.north.camera.url", "bays.bay4"):
            (fault,) = (await asked.post("preview", (path, {} if path == "bays.bay4" else "1"))).json["faults"]
            assert fault["message"] == "is set on the command line, whatever the file says"
        assert (await asked.post("save", ("site", "mine"), ("fusion.radius_threshold_px", 170))).status == 200
        assert 'name = "north"' in asked.path.read_text()
        asked.path.write_text(one.replace("camera.url = ", "# ") + '[[bays]]\nname = "south"\nunit_id = 2\n')
        faults = (await asked.settings())["faults"]
        assert "its camera.url, 0, is that of bay 'north', too: each bay needs its own" in faults[0]["message"]


@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_restart_needs_confirmation_time_and_no_truck(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    async with page(tmp_path / "plant.toml") as asked:

        async def restart(**body: Any) -> Answer:
            return await asked.api_client.post("/api/setup/restart", body)

        assert (await restart()).json["error"] == "confirm"
        assert "it can be restarted 10 s after its start" in (await restart(confirmed=True)).json["detail"]
        await asyncio.sleep(11)
        for _ in range(20):
            asked.made.loading("A")
            await asyncio.sleep(0.1)
        assert asked.made.controls["A"].state().visit.phase is VisitPhase.APPROACHING
        refused = await restart(confirmed=True)
        assert (refused.status, refused.json["error"]) == (409, "truck")
        assert refused.json["detail"] == "a truck is at a bay (bay A: a truck on its way in, D = 0)"
        asked.made.controls["A"].check_function(FunctionCheck.MAY_MOVE_KEPT)
        assert (await restart(confirmed=True)).status == 409
        asked.path.write_text("site = 3\n")
        wrong = await restart(confirmed=True, despite_trucks=True)
        assert (wrong.status, wrong.json["detail"][:30]) == (422, "it would not start: site: 3: I")
        assert asked.restart.stop.is_set() is False
        asked.path.write_text(FILE)
        assert (await restart(confirmed=True, despite_trucks=True)).json["seconds"] == 10
        assert asked.restart.stop.is_set()
        asked.restart.stop.clear()
        asked.made.controls["A"].check_function(FunctionCheck.MAY_MOVE_OFF)  # nobody loads there
        assert (await restart(confirmed=True)).status == 200
        assert asked.restart.stop.is_set()
        assert "the gateway is started again, by 10.0.0.7 (anna" in caplog.text
        boot = (await asked.api_client.get("/api/setup/boot")).json
        assert boot == {"boot": asked.made.client.about.boot}


@pytest.mark.one_interpreter
@in_virtual_time
async def test_a_truck_that_was_in_place_is_at_the_bay_also_where_no_sensor_shows_it(tmp_path: Path) -> None:
    async with page(tmp_path / "plant.toml") as asked:
        control = asked.made.controls["A"]
        await asyncio.sleep(11)
        for _ in range(50):
            now_ns = asked.made.client.clock.now_ns()
            control.on_reading(VisionReading(now_ns, Quality.GOOD, Circle(320, 240, 200), frame_id=7))
            control.on_reading(RangeReading(now_ns, Quality.GOOD, 250.0))
            await asyncio.sleep(0.1)
        assert control.state().visit.phase is VisitPhase.IN_PLACE
        await asyncio.sleep(3)
        assert control.state().visit.phase is VisitPhase.UNKNOWN
        refused = await asked.api_client.post("/api/setup/restart", {"confirmed": True})
        assert (refused.status, refused.json["error"]) == (409, "truck")
        assert refused.json["detail"] == (
            "a truck is at a bay (bay A: a truck was in place, and is not known to have left)"
        )
        assert not asked.restart.stop.is_set()


BROAD = [  # of the picture, nearly all of it is red
    ("vision.method", "paper"),
    ("vision.red_low_1", [0, 0, 0]),
    ("vision.red_high_1", [180, 255, 255]),
]


@pytest.mark.long
@pytest.mark.one_interpreter
@in_virtual_time
async def test_settings_of_vision_with_warnings_are_saved_only_when_each_is_accepted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async with page(tmp_path / "plant.toml") as asked:
        for ring in asked.made.rings.values():
            ring.write(picture(), 1, asked.made.client.clock.now_ns())
        refused = await asked.post("save", *BROAD)
        assert (refused.status, refused.json["error"]) == (409, "warnings")
        assert "these settings are saved with " in refused.json["detail"]
        assert asked.path.read_text() == FILE
        warnings = {one["id"]: one for one in refused.json["warnings"]}
        broad = warnings["red_low_1: too broad: the red ranges let in # % of the picture [100]"]
        assert broad["pictures"] == ["A/live", "B/live"]  # both use it
        of_one = await asked.post("save", *((f"bays.B.{path}", value) for path, value in BROAD))
        assert {tuple(one["pictures"]) for one in of_one.json["warnings"]} == {("B/live",)}
        others = [name for name in warnings if name != broad["id"]]
        assert (await asked.post("save", *BROAD, accepted=others)).status == 409
        assert (await asked.post("preview", *BROAD)).status == 200  # looking asks nothing

        assert (await asked.post("save", *BROAD, accepted=[*warnings])).status == 200
        assert "A, B: settings are saved despite: " in caplog.text
        await asyncio.sleep(5)  # not too many requests for the file
        assert (await asked.post("save", ("site", "other"))).status == 200  # these settings of vision stay
        assert (await asked.post("save", ("vision.workers", 2))).status == 200  # not tuned
        assert (await asked.post("save", ("vision", None))).status == 200  # without warnings
        assert (await asked.post("save", undo=True)).status == 200


@pytest.mark.long
@pytest.mark.one_interpreter
@settings(max_examples=examples(4), deadline=None)
@given(secret=st.text("abcXYZ019-_.!~", min_size=6, max_size=20))
def test_no_password_ever_leaves(tmp_path_factory: pytest.TempPathFactory, secret: str) -> None:
    marked = f"Q{secret}Q"
    changes = (
        ("mqtt.url", None),
        ("mqtt.urls", [f"mqtt://u:{marked}@host", f"mqtt://{marked}:{marked}@b"]),
        ("bays.A.camera.url", f"rtsp://u:{marked}@host/1"),
        ("camera.url", f"http://cam/v?password={marked}"),
        ("sinks.postgresql", {"url": f"postgresql://u:{marked}@host/db"}),
    )

    async def answers() -> str:
        async with page(tmp_path_factory.mktemp("p") / "plant.toml") as asked:
            texts = [(await asked.post(name, *changes)).text for name in ("preview", "save")]
            assert asked.path.read_text().count(marked) == 6
            return "".join([*texts, (await asked.api_client.get("/api/setup/settings")).text])

    shown = run(answers())
    assert marked not in shown
    assert shown.count("***") > 10
