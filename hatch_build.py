"""The engine is compiled while the package is built, into the wheel or beside an editable installation."""

from __future__ import annotations

import runpy
import shutil
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PLACE = "armflex/mechanics/engine"


class EngineHook(BuildHookInterface):
    """Compiles engine.c by the machine's own compiler, or by that of ziglang, which is then a build requirement."""

    def dependencies(self) -> list[str]:
        """Return what is needed beside hatchling."""
        return [] if self._build()["own_compiler"]() or self.target_name != "wheel" else ["ziglang>=0.13"]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Put the libraries into the wheel."""
        build, self._made = self._build(), Path(tempfile.mkdtemp(prefix="engine-"))
        editable = version == "editable"
        into, folder = ("force_include_editable", build["BESIDE"]) if editable else ("force_include", PLACE)
        for library in build["compile_engine"](self._made):
            build_data[into][str(library)] = f"{folder}/{library.name}"
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Leave nothing behind."""
        shutil.rmtree(self._made, ignore_errors=True)

    def _build(self) -> dict[str, Any]:
        return runpy.run_path(str(Path(self.root) / PLACE / "build.py"))
