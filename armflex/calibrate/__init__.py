"""From a measured campaign to a calibrated arm: MAP least squares through the deflected equilibrium."""

from armflex.calibrate.bootstrap import Bootstrap as Bootstrap
from armflex.calibrate.bootstrap import bootstrap as bootstrap
from armflex.calibrate.calibrate import Calibration as Calibration
from armflex.calibrate.calibrate import calibrate as calibrate
