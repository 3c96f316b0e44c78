"""What people look at: headless meshcat pages of an arm, and pictures of the laws that it learned."""

from armflex.show.view.arm_scene import view as view
from armflex.show.view.law_curves import draw_laws as draw_laws
