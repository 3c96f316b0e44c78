"""Files as people have them (a tracker's export, a controller's log) joined to one campaign.

`sources` reads a file into columns without knowing what they are, `meanings` says what each column is, and `settled`
what is wrong or open in it. `parts` chooses what of recordings counts, `standing` reduces them to where the arm stood,
`pairing` says which rows of two files are of one another, and `campaign` has their columns. `join` goes through all.
"""

from armflex.intake.campaign import Intake as Intake
from armflex.intake.join import intake as intake
