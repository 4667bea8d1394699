"""Build hook: compile the vision kernels where there is a C compiler, and the ranger's firmware where there is one for
AVR; add the manual that the pages serve.

Without a compiler the package is whole, only slower; without that for AVR the pages offer no firmware.
"""

import runpy
import shutil
import subprocess
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ROOM = Path("gateway/vision/compiled")


class KernelHook(BuildHookInterface):  # type: ignore[misc, type-arg, unused-ignore]
    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if self.target_name != "wheel":
            return
        if version != "editable":
            docs = Path(self.root, "docs")
            manual = (*docs.glob("*.md"), *docs.glob("images/*"))
            build_data["force_include"].update({str(p): f"gateway/manual/{p.relative_to(docs)}" for p in manual})
            self._add_firmware(build_data)
        if why := runpy.run_path(str(Path(self.root) / ROOM / "build.py"))["build"]():
            self.app.display_warning(f"without the compiled vision kernels: {why}")
            return
        machine = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{machine}"  # plain C, loaded by ctypes: any Python will do
        if version != "editable":
            build_data["artifacts"].append(str(ROOM / "_kernels.so"))

    def _add_firmware(self, build_data: dict[str, Any]) -> None:
        folder = Path(self.root, "firmware")
        if shutil.which("avr-gcc") and shutil.which("make"):
            subprocess.run(["make", "-s", "-C", str(folder)], check=False, stdout=subprocess.DEVNULL)
        if (program := folder / "build" / "ranger.hex").is_file():
            build_data["force_include"][str(program)] = "gateway/ranger/hcsr04/ranger.hex"
        else:
            self.app.display_warning(
                "without the ranger's firmware: gcc-avr, avr-libc and arduino-core-avr are missing"
            )
