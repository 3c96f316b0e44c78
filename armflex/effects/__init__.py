"""Effects beyond the declared arm, one file per law; `CATALOGUE` maps the names that files use."""

from armflex.effects.catalogue import CATALOGUE as CATALOGUE
from armflex.effects.law import Effect as Effect
from armflex.effects.law import EffectLaw as EffectLaw
from armflex.effects.law import LoadLaw as LoadLaw
from armflex.effects.law import TwistLaw as TwistLaw
from armflex.effects.spot import Spot as Spot
