"""From a measured campaign to a calibrated arm: MAP least squares through the deflected equilibrium."""

from armflex.estimate.bootstrap import Bootstrap as Bootstrap
from armflex.estimate.bootstrap import bootstrap as bootstrap
from armflex.estimate.calibrate import Calibration as Calibration
from armflex.estimate.calibrate import calibrate as calibrate
