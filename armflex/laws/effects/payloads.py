"""What the effects of a wrong payload share."""

from __future__ import annotations

from typing import TYPE_CHECKING

from armflex.conventions import Array
from armflex.laws.effects.scene import Scene

if TYPE_CHECKING:
    from armflex.estimate.view import View


def loaded_names(scene: Scene) -> tuple[str, ...]:
    """Return '' for all payloads together, and the name of each where a campaign has several that weigh."""
    mass = scene.column("payload_mass")
    names = sorted({name for name, kilograms in zip(scene.payloads, mass, strict=True) if kilograms > 0.0})
    return ("", *names) if len(names) > 1 else ("",) * len(names)


def tip_wrenches(view: View, wrenches: Array) -> Array:
    """Return (M, d, k) changes of the readings for (M, 6, k) wrenches at the tip, base axes."""
    index = view.line.link_names.index(view.setup.arm.robot.tip)
    return view.answer(view.line.link_loads[:, index] @ wrenches)
