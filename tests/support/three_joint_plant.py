"""An arm of three joints that a test's own plant reads."""

from __future__ import annotations

from support.small_arms import joint, link, robot

URDF = robot(
    link("base"),
    joint("J1", "base", "one", (0, 0, 0.4), axis=(0, 0, 1)),
    link("one", 20.0, (0, 0, 0.2)),
    joint("J2", "one", "two", (0.1, 0, 0.3)),
    link("two", 10.0, (0.4, 0, 0)),
    joint("J3", "two", "three", (0.9, 0, 0)),
    link("three", 4.0, (0.3, 0, 0)),
    joint("flange", "three", "tip", (0.6, 0, 0.1), kind="fixed"),
    link("tip"),
)
ARM = """[robot]
urdf = "r.urdf"
tip = "tip"
gravity = [0.0, 0.0, -9.81]

[flexure.J2]
joint = "J2"
model = "linear"
compliance = [0.0, 0.0, 0.0, 1e-6, 4e-6, 1e-6]

[measurement]
frame = "unknown"

[prior]
joint_offset = 1e-3
compliance = 0.2
"""
SIGMA = 5e-5
