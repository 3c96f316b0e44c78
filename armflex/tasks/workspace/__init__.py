"""The whole workspace at once: millions of configurations, reduced to where the tip is and how far it moves there."""

from armflex.tasks.workspace.map_picture import draw_map as draw_map
from armflex.tasks.workspace.workspace_map import WorkspaceMap as WorkspaceMap
from armflex.tasks.workspace.workspace_map import map_workspace as map_workspace
from armflex.tasks.workspace.workspace_map import read_map as read_map
from armflex.tasks.workspace.workspace_map import write_map as write_map
