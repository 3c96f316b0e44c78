"""Calibration kept up with an arm, reading by reading."""

from armflex.track.reading import Reading as Reading
from armflex.track.tracker import Step as Step
from armflex.track.tracker import Tracker as Tracker
from armflex.track.watch import Change as Change
