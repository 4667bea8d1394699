"""A package is uploaded in pieces and a request left for the unit that updates as root; nothing is judged here."""

import base64
import json
import os
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

from gateway.processes.answers import QuestionRefusedError
from gateway.update_request import ShownUpdate
from gateway.web.auth.refusals import RefusalError
from gateway.web.ipc.updates import UpdatesQuestion
from gateway.web.setup import update_process
from tests.unit.web.gateway_client import plant
from tests.unit.web.programs import ApiClient, api_client, fits
from tests.virtual_time import in_virtual_time

URL = "/api/setup/update"
SHOWN = ShownUpdate(
    version="1.0", previous="0.9", stage="ended", old="0.9", new="1.0", outcome="updated", log=("done",)
)


@dataclass
class Direct:
    """The helper process, without the process."""

    folder: Path

    async def ask(self, question: UpdatesQuestion, data: bytes | None = None) -> bytes:
        sent: list[bytes] = []
        fds = [] if data is None else [os.memfd_create("data")]
        try:
            for fd in fds:
                os.write(fd, data or b"")
            update_process.answer(self.folder / "update", self.folder / "update.json", question, fds, sent.append)
        except QuestionRefusedError as error:
            raise RefusalError(409, "refused", str(error)) from None
        finally:
            for fd in fds:
                os.close(fd)
        return sent[0]


@asynccontextmanager
async def page(folder: Path) -> AsyncIterator[ApiClient]:
    (folder / "update.json").write_bytes(msgspec.json.encode(SHOWN))
    async with plant() as made:
        client = api_client(made)
        client.app.state.services = replace(client.app.state.services, updates=Direct(folder))
        yield client


def piece(file: str, data: bytes, offset: int = 0, size: int | None = None) -> dict[str, object]:
    return {"file": file, "offset": offset, "size": size or len(data), "data": base64.b64encode(data).decode()}


@in_virtual_time
async def test_a_package_and_its_signature_then_the_request(tmp_path: Path) -> None:
    spool = tmp_path / "update"
    async with page(tmp_path) as client:
        found = fits((await client.get(URL)).text, "UpdateView")
        assert (found["shown"]["previous"], found["package_bytes"], found["pending"]) == ("0.9", 0, False)
        refused = await client.post(URL, {"action": "install"})
        assert (refused.status, refused.json["detail"]) == (409, "choose a package and its signature first")
        assert (await client.post(f"{URL}/piece", piece("package", b"old old"))).json["package_bytes"] == 7
        await client.post(f"{URL}/piece", piece("package", b"one ", size=7))
        for wrong, why in (
            (piece("package", b"two", 3, 7), "another upload goes on"),
            (piece("package", b"two and more", 4, 7), "more than the file has"),
            (piece("signature", b"x", 0, 70_000), "no detached signature"),
        ):
            refused = await client.post(f"{URL}/piece", wrong)
            assert refused.status == 409
            assert why in refused.json["detail"]
        await client.post(f"{URL}/piece", piece("package", b"two", 4, 7))
        await client.post(f"{URL}/piece", piece("signature", b"signed"))
        asked = await client.post(URL, {"action": "install", "bays": ["bay1"], "alarms": ["picture_blind"]})
        assert asked.json["pending"]
        assert [(spool / name).read_bytes() for name in ("package.deb", "package.deb.asc")] == [b"one two", b"signed"]
        request = json.loads((spool / "request.json").read_bytes())
        assert request == {"action": "install", "bays": ["bay1"], "alarms": ["picture_blind"]}
        for path, body in ((URL, {"action": "back"}), (f"{URL}/piece", piece("package", b"other"))):
            refused = await client.post(path, body)
            assert (refused.status, refused.json["detail"]) == (409, update_process.PENDING)


@in_virtual_time
async def test_a_package_that_is_too_large_is_not_begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1_999_000_000))
    async with page(tmp_path) as client:
        refused = await client.post(f"{URL}/piece", piece("package", b"one", size=900_000_000))
        assert (refused.status, refused.json["detail"]) == (409, "2000 MB of the disk are needed, 1999 MB are free")
        assert (await client.post(f"{URL}/piece", piece("package", b"one", size=1_000_000_001))).status == 400


@in_virtual_time
async def test_a_gateway_that_was_not_installed_from_its_package_says_so() -> None:
    async with plant() as made:
        refused = await api_client(made).get(URL)
        assert (refused.status, refused.json["error"]) == (503, "not_installed")
