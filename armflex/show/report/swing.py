"""How the arm of a report swings: its slowest modes where the campaign had it carry most."""

from types import SimpleNamespace

import numpy as np

from armflex.arm import Arm
from armflex.errors import ArmflexError
from armflex.measured.measurements import Measurements
from armflex.rows.wrench import wrenches_in
from armflex.show.report.svg import INK, MARK, blank, inline
from armflex.show.view.mode_picture import MOST, swing_on


def swing(arm: Arm, measurements: Measurements, rows: np.ndarray) -> SimpleNamespace | None:
    """Return figure, table and text about the modes of an arm; None of an arm without a flexure.

    The pose is that of the first of (M,) rows of the campaign with the heaviest payload.
    """
    if not arm.flexures:
        return None
    carried = measurements.payload
    row = int(rows[np.argmax([arm.payload(carried[i]).mass for i in rows])])
    columns = {name: values[row] for name, values in measurements.known.items()}
    try:
        given = {"covariates": columns, "wrenches": wrenches_in(measurements.wrenches, row), "enforce_limits": False}
        rest = arm.deflection(measurements.q[row], carried[row], **given)
        modes = arm.modes(measurements.q[row], carried[row], count=MOST, **given)
    except ArmflexError as error:
        return SimpleNamespace(figure="", rows=(), text=f"Not computed: {error}")
    figure = blank()
    swing_on(figure, rest, modes, MARK, INK)
    stiffest = modes.sensitivities.argmax(axis=1)
    return SimpleNamespace(
        figure=inline(figure, "modes of vibration"),
        rows=tuple(
            (f"{modes.frequencies[i]:.3g} Hz", f"{modes.decays[i]:.2g} s", f"{modes.names.flexures[j]} ({share:.0%})")
            for i, j in enumerate(stiffest)
            for share in [modes.sensitivities[i, j]]
        ),
        text=" ".join(
            [
                f"At pose {measurements.pose[row]} with payload {carried[row]}, drives holding.",
                *(f"{flag.text[0].upper()}{flag.text[1:]}." for flag in modes.flags),
            ]
        ),
    )
