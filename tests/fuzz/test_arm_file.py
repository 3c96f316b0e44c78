"""arm.toml, as declared and as calibrated or traced, spoilt: refused by name, or it deflects and predicts."""

import tomllib
from collections.abc import Mapping
from typing import Any

import numpy as np
from harness import as_toml, cases, judge, mutated_bytes, mutated_tree, written
from hypothesis import given
from hypothesis import strategies as st
from seeds import ARM, OF_THE_MODEL, asked, declared, quietly, traced
from support.small_arms import ROBOTS

from armflex import Arm, load_arm, predict, total_covariance

PLACED = """payload_rating = 30.0
tool = { xyz = [0.05, 0.0, 0.1], rpy = [0.0, 0.2, 0.0] }
mount = { rpy = [0.0, 0.0, 0.4] }
"""
STIFF = """
[flexure.D]
joint = "roll"
joint_stiffness = 3e6

[flexure.K]
joint = "yaw"
stiffness = [1e9, 2e9, 1e9, 4e7, 4e7, 2e7]
"""
WHOLE = ARM.replace("LEARN", 'model = "linear"\nlearn = true') + OF_THE_MODEL
WHOLE = WHOLE.replace("payload_rating = 30.0\n", PLACED).replace("[measurement]", f"{STIFF}\n[measurement]")
KNOWN = {
    "temperature": 22.0,
    "temperature_lagged_100s": 21.0,
    "time": 5.0,
    "approach_yaw": 1.0,
    "approach_lift": -1.0,
    "approach_roll": 1.0,
}


def computed(arm: Arm) -> Mapping[str, Any]:
    """Return what an arm does where it hangs, loaded with the first payload, and what it predicts for two rows."""
    numbers: dict[str, Any] = {}
    q = np.clip(np.zeros(len(arm.joint_names)), arm.robot.lower, arm.robot.upper)
    for payload in [*arm.payloads, "none"][:2]:
        found = arm.deflection(q, payload, covariates=KNOWN if arm.effects else None)
        numbers |= {f"displacement {payload}": found.displacement, f"covariance {payload}": found.covariance}
        whole = total_covariance(found)
        if whole is not None:  # infinite along axes whose motion depends on what nothing determined
            known = np.isfinite(np.diag(whole))
            numbers |= {f"covariance in all {payload}": whole[np.ix_(known, known)]}
            numbers |= {f"sigma in all {payload}": np.diag(whole)}
    predicted = predict(arm, asked())
    return numbers | {
        "position": predicted.position,
        "sigma": predicted.sigma,
        "rotation": predicted.rotation,
        "displaced": predicted.displacement,
    }


def judged(name: str, text: bytes | str) -> bool:
    declared()  # writes the URDF
    path = written(name, text)
    return judge(lambda: load_arm(path), path, computed, names=("robot.urdf",))


def spoilt_text(seed: str) -> st.SearchStrategy[bytes]:
    return mutated_bytes(seed.encode())


def test_the_seeds_are_accepted() -> None:
    assert judged("arm.toml", WHOLE)
    assert judged("arm.toml", as_toml(tomllib.loads(WHOLE)))
    for learn in (False, True):
        assert judged("arm.toml", as_toml(traced(learn)))


@cases(200)
@given(mutated_tree(tomllib.loads(WHOLE)))
def test_a_spoilt_declaration(tree: dict[str, Any]) -> None:
    judged("arm.toml", as_toml(tree))


@cases(150)
@given(spoilt_text(WHOLE))
def test_spoilt_text(text: bytes) -> None:
    judged("arm.toml", text)


@cases(60)
@given(st.sampled_from(("tarm_like", "heavy_six")).flatmap(lambda name: st.tuples(st.just(name), bundled(name))))
def test_a_spoilt_bundled_arm(case: tuple[str, dict[str, Any]]) -> None:
    name, tree = case
    robot = tree.get("robot")
    if isinstance(robot, dict) and robot.get("urdf") == "robot.urdf":
        robot["urdf"] = str(ROBOTS / name / "robot.urdf")
    path = written("bundled.toml", as_toml(tree))
    judge(lambda: load_arm(path), path, bent, names=("robot.urdf",))


def bundled(name: str) -> st.SearchStrategy[dict[str, Any]]:
    return mutated_tree(tomllib.loads((ROBOTS / name / "arm.toml").read_text()))


def bent(arm: Arm) -> Mapping[str, Any]:
    q = np.clip(np.zeros(len(arm.joint_names)), arm.robot.lower, arm.robot.upper)
    found = arm.deflection(q, next(iter(arm.payloads), "none"))
    return {"displacement": found.displacement, "covariance": found.covariance}


def calibrations(learn: bool) -> st.SearchStrategy[dict[str, Any]]:
    """Return [calibration] tables; the seed takes a fit, so it is not made where tests are only collected."""
    return st.deferred(lambda: mutated_tree(traced(learn)["calibration"]))


@cases(250)
@given(calibrations(False))
def test_a_spoilt_calibration(tree: dict[str, Any]) -> None:
    judged("traced.toml", as_toml(traced(False) | {"calibration": tree}))


@cases(120)
@given(calibrations(True))
def test_a_spoilt_calibration_with_a_learned_law(tree: dict[str, Any]) -> None:
    judged("traced.toml", as_toml(traced(True) | {"calibration": tree}))


@cases(80)
@given(st.deferred(lambda: mutated_tree({"effect": traced()["effect"]})))
def test_a_traced_arm_with_spoilt_effects(tree: dict[str, Any]) -> None:
    judged("traced.toml", as_toml(without(traced()) | tree))


def without(tree: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in tree.items() if key != "effect"}


def test_a_preset_is_read_as_well() -> None:
    assert quietly(declared(), preset="other").flexure_names[:4] == ("Y", "L", "S", "R")
