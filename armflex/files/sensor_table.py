"""[instrument.NAME] in an arm.toml: an instrument beside the one at the tip."""

import numpy as np

from armflex.conventions import SMALLEST_STD
from armflex.declaration import Declaration
from armflex.readings import SENSOR_KINDS
from armflex.readings.sensor import LONGEST, Sensor
from armflex.robot import Robot


def read_sensors(tables: dict[str, Declaration], robot: Robot) -> dict[str, Sensor]:
    """Return the instruments of an arm file by name, in the order in which their readings stand in a row.

    Raises:
        ArmFileError: A kind, a link or a joint is not known, or a number is none of its kind.
    """
    sensors = [_read(name, table, robot) for name, table in tables.items()]
    units = list(LONGEST)
    return {sensor.name: sensor for sensor in sorted(sensors, key=lambda reading: units.index(reading.kind.unit))}


def _read(name: str, table: Declaration, robot: Robot) -> Sensor:
    kind = SENSOR_KINDS[table.choice("kind", tuple(SENSOR_KINDS))]
    said = kind.declared(table, robot)
    kind = said.pop("kind", kind)
    declared, std = [np.zeros(0)], [np.zeros(0)]
    for nuisance in kind.nuisances:
        value, size = kind.stated(nuisance, table, robot)
        declared.append(value)
        std.append(np.full(len(value), size))
    sigma = table.std("sigma")
    if not SMALLEST_STD <= sigma <= LONGEST[kind.unit]:
        raise table.fail("sigma", f"expected one standard deviation of a reading [{kind.unit}], got {sigma:g}")
    table.finish()
    return kind.sensor(name, kind, sigma=sigma, declared=np.concatenate(declared), std=np.concatenate(std), **said)
