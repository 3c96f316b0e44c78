"""What an instrument reads of an arm: one file for every kind, and all of a campaign's together.

Nothing outside this room knows how many numbers a reading has, or what of the arm it sees.
"""

from armflex.plugins import Registry
from armflex.readings.acceleration import Acceleration as Acceleration
from armflex.readings.direction import Direction as Direction
from armflex.readings.distance import Distance as Distance
from armflex.readings.encoder import Encoder as Encoder
from armflex.readings.encoder import SlideEncoder as SlideEncoder
from armflex.readings.frequency import Frequency as Frequency
from armflex.readings.height import Height as Height
from armflex.readings.inclination import Inclination as Inclination
from armflex.readings.kind import Kind as Kind
from armflex.readings.load import Force as Force
from armflex.readings.load import Moment as Moment
from armflex.readings.load import Torque as Torque
from armflex.readings.orientation import Orientation as Orientation
from armflex.readings.pixels import Camera as Camera
from armflex.readings.pixels import Pixels as Pixels
from armflex.readings.position import Position as Position
from armflex.readings.postures import Postures as Postures
from armflex.readings.readings import Readings as Readings
from armflex.readings.readings import unread as unread
from armflex.readings.relative import RelativePosition as RelativePosition
from armflex.readings.sensor import Sensor as Sensor
from armflex.readings.touch import SocketDistance as SocketDistance
from armflex.readings.touch import Sockets as Sockets
from armflex.readings.touch import Touch as Touch
from armflex.readings.touch import TouchingSensor as TouchingSensor
from armflex.readings.touch import sockets_of as sockets_of
from armflex.readings.touch import touched as touched


def _fault(name: str, kind: object) -> str:
    right = isinstance(kind, type) and issubclass(kind, Kind)
    return "" if right else "expected a class of readings, a Kind of armflex.readings"


_BUNDLED: dict[str, type[Kind]] = {
    "position": Position,
    "orientation": Orientation,
    "distance": Distance,
    "height": Height,
    "relative_position": RelativePosition,
    "inclination": Inclination,
    "acceleration": Acceleration,
    "encoder": Encoder,
    "touch": Touch,
    "force": Force,
    "moment": Moment,
    "torque": Torque,
    "pixels": Pixels,
    "frequency": Frequency,
    "direction": Direction,
}

SENSOR_KINDS: Registry[type[Kind]] = Registry("armflex.readings", _BUNDLED, _fault)
"""What [instrument.NAME] may be, as its `kind` says."""
