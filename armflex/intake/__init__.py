"""Files as people have them (a tracker's export, a controller's log) joined to one campaign.

`sources` reads a file into columns without knowing what they are. `meanings` says what each column is. `join` brings
the rows of several files together, by name, by time or by order.
"""

from armflex.intake.join import Intake as Intake
from armflex.intake.join import intake as intake
