"""Campaigns that others published: read from the folder that ARMFLEX_PUBLIC names, and skipped where it names none."""

import os
import tempfile
from functools import cache
from pathlib import Path

import public
import pytest

from armflex import Arm
from armflex.measured.measurements import Measurements, read_measurements
from support.effect_arms import quietly

DIR = os.environ.get("ARMFLEX_PUBLIC", "")
WITH_DIR = "ARMFLEX_PUBLIC=DIR python -m pytest tests/unit/test_public.py, DIR as in tests/public.py"
where_published = pytest.mark.skipif(not DIR, reason=f"measured elsewhere, not carried here: {WITH_DIR}")


@cache
def campaign(name: str) -> tuple[Arm, Measurements]:
    """Return an arm as declared and its campaign: ur5_tsinghua (1000 poses) or wam_tsinghua (216)."""
    with tempfile.TemporaryDirectory() as converted:
        file, table = public.published(Path(DIR), Path(converted))[name]
        arm = quietly(file)
        return arm, read_measurements(table, arm)
