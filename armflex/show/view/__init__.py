"""What people look at: headless meshcat pages of an arm, and pictures of the laws that it learned."""

from armflex.show.view.laws import draw_laws as draw_laws
from armflex.show.view.view import view as view
