"""All tables of cures that are tried, of which each says by what."""

import cures_of_arms
import cures_of_calls
import cures_of_camera_files
import cures_of_cameras
import cures_of_cells
import cures_of_devices
import cures_of_followers
import cures_of_lights
import cures_of_many_cameras
import cures_of_motions
import cures_of_programs
import cures_of_robots
import cures_of_runs
import cures_of_scenes
import cures_of_tables
import cures_of_trackers

PARTS = (
    cures_of_tables,
    cures_of_runs,
    cures_of_cameras,
    cures_of_calls,
    cures_of_arms,
    cures_of_robots,
    cures_of_motions,
    cures_of_cells,
    cures_of_devices,
    cures_of_lights,
    cures_of_scenes,
    cures_of_followers,
    cures_of_many_cameras,
    cures_of_camera_files,
    cures_of_trackers,
    cures_of_programs,
)
FILES = {name: text for part in PARTS for name, text in part.FILES.items()}
TRIED = {entry: trial for part in PARTS for entry, trial in part.TRIED.items()}
"""By module and words of the cure: what is refused, and the same as the cure has it. Commands stand as text, several
joined by &&, {} for those before; calls as functions of nothing."""
