"""What people look at: headless meshcat pages of an arm."""

from armflex.view.view import view as view
