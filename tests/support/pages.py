"""A page as a real browser draws it."""

import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


QUIET = (
    *("headless", "no-sandbox", "disable-gpu", "disable-quic", "no-first-run", "disable-background-networking"),
    *("disable-component-update", "disable-sync", "enable-unsafe-swiftshader", "hide-scrollbars"),
)
"""Flags of a browser that asks nobody anything."""


def browse(address: str, flags: Sequence[str], profile: Path) -> str:
    """Return what a browser writes about a page; one that hangs, as it does now and then, is asked again."""

    def once(number: int, seconds: float) -> str:
        command = [BROWSER, *(f"--{flag}" for flag in flags), f"--user-data-dir={profile} {number}", address]
        return subprocess.run(command, check=True, capture_output=True, text=True, timeout=seconds).stdout

    try:
        return once(1, 120)
    except subprocess.TimeoutExpired:
        return once(2, 600)


def picture(page: Path, virtual_ms: int, asked: str = "") -> np.ndarray:
    """Screenshot of the canvas right of the panel, (H, W, 3), after so much time in the page.

    `asked` is what its address ends in.
    """
    image = pytest.importorskip("PIL.Image", reason="decoding a screenshot needs Pillow")
    target = page.with_suffix(f".{virtual_ms}.png")
    asking = [*QUIET, "window-size=1280,800", f"screenshot={target}", f"virtual-time-budget={virtual_ms}"]
    browse(page.as_uri() + asked, asking, page.parent / f"profile {virtual_ms}")
    return np.asarray(image.open(target).convert("RGB"), dtype=float)[:, 300:]


def sheets(page: str, folder: Path) -> int:
    """How many sheets a page takes when a browser prints it."""
    folder.mkdir()
    (folder / "page.html").write_text(page)
    browse((folder / "page.html").as_uri(), [*QUIET, f"print-to-pdf={folder / 'page.pdf'}"], folder / "profile")
    return len(re.findall(rb"/Type\s*/Page[^s]", (folder / "page.pdf").read_bytes()))


def hue_share(pixels: np.ndarray, color: str) -> float:
    """Share of the pixels which have the hue of `color`, whatever the light on them."""
    wanted = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)], dtype=float)
    tint, wanted = (x - x.mean(axis=-1, keepdims=True) for x in (pixels, wanted))
    strength = np.linalg.norm(tint, axis=-1)
    likeness = tint @ wanted / (np.maximum(strength, 1e-9) * np.linalg.norm(wanted))
    return float(np.mean((likeness > 0.98) & (strength > 50.0)))
