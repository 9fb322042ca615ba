"""Cures are tried: followed to the letter on the case that causes them, here by commands, or in a test named here.

A new cure that names a flag, a command or a unit needs its entry: the number of those without one may only fall.
"""

import re
import shlex
import sys

import pytest
import typer
from cure_tables import TRIED
from typer.testing import CliRunner

from armsight.errors import ArmsightError
from cure_inventory import NAMES, ROOT, Cure, cures, cures_of

UNTRIED = 0
"""Cures that name a flag, a command or a unit and are followed nowhere yet. Lower it when entries are added."""

FOLLOWED_IN = {
    "test_an_arm_is_calibrated_by_a_program_and_a_take_of_its_rests": [
        "ops/join.py: Leave the same out of both",
        "verify/pairing.py: `armsight join --still` makes one row of each rest",
    ],
    "test_a_robots_program_is_the_commanded_side": ["store/interpret/read.py: A program's points have no times"],
    "test_a_shape_that_looks_like_itself_from_another_side_is_refused": [
        "store/interpret/trackers/clouds.py: Name with --body those of its markers"
    ],
    "test_its_cures_verify": ["verify/alignment.py: Give --align both, or the arm with its tool in its file"],
    "test_the_old_layout_is_read": ["ops/calibration/board_images.py: perhaps --board"],
    "test_touched_points_are_named_and_touching_is_the_cure": [
        "calibrate/arm/points.py: armsight measure",
        "ops/calibrate_robot.py: Leave them away with --touch",
    ],
    "test_gauges_read_in_millimetres_and_columns_exchanged_are_refused": [
        "calibrate/arm/touch/model.py: Give reading_m in m"
    ],
    "test_a_height_in_millimetres_taken_as_metres_is_refused": [
        "calibrate/handeye/one_axis.py: Give metres, or the unit with the number"
    ],
    "test_other_cameras_than_a_pair_are_planned_as_they_are_calibrated": [
        "armsight_lab/design/plan.py: Calibrate them (armsight calibrate cameras)"
    ],
    "test_a_camera_apart_is_told_with_its_cure_and_each_cure_keeps_it": [
        "drivers/timed_moments.py: Set all cameras to one frame rate and one clock"
    ],
    "test_a_target_without_a_light_to_follow_is_refused_before_anything_moves": [
        "ops/identification/beacon_observer.py: Give a target of one light"
    ],
    "test_limits_beyond_the_range_that_a_link_tells_are_refused_before_anything_moves": [
        "ops/identification/live.py: for it in --limits, or less"
    ],
    "test_a_joint_that_counts_the_other_way_is_named_and_the_cure_works": [
        "calibrate/arm/senses.py: Change the sign of {} in the arm"
    ],
    "test_a_mount_that_creeps_is_named_and_the_rig_is_right": ["calibrate/cameras/lens_choice.py: Use --lens"],
    "test_the_rig_stands_in_the_axes_of_the_base_link": ["calibrate/handeye/pairs.py: armsight calibrate robot-world"],
    "test_a_mount_that_slipped_is_told_with_the_row": ["calibrate/handeye/advice.py: on apart"],
    "test_stamps_in_ms_us_or_ns_are_named_by_their_step_and_seconds_are_the_cure": [
        "calibrate/timing/stamps.py: Give its stamps in seconds"
    ],
    "test_a_narrow_pivot_is_refused_for_its_tilt": ["calibrate/tooltip.py: 25 degrees"],
    "test_a_point_that_is_not_where_it_was_measured_is_refused": ["calibrate/tooltip_result.py: Leave the point out"],
    "test_two_settings_in_one_table_are_told_with_the_row": ["calibrate/tooltip_result.py: on apart"],
    "test_of_two_bodies_nobody_chooses_by_a_name": ["store/interpret/standard.py: Give --columns with -"],
    "test_damage_within_is_told_and_costs_one_chunk": ["store/recording/record_reader.py: `armsight record --repair`"],
    "test_a_file_that_breaks_off_is_saved_as_its_cure_says": ["store/bags.py: `armsight record --repair {}"],
    "test_a_damaged_database_is_saved_as_its_cure_says": ["store/bags.py: `sqlite3 FILE '.clone mended.db3'`"],
    "test_what_is_not_found_is_named_and_left_out_only_when_asked": [
        "ops/path/picks.py: ; or leave them out with --skip",
        "ops/path/picks.py: Leave them out with --skip",
    ],
    "test_two_arms_in_one_cell_are_told_and_not_held_against_each_other": ["armsight_lab/history/series.py: --since"],
    "test_covered_views_exchanged_or_joined_are_told": [
        "calibrate/mirrors/calibration.py: Exchange the sources of --left-only"
    ],
    "test_what_is_refused_is_read_once_its_cure_is_followed": [
        "store/urdf_tree.py: Write radians",
        "store/urdf_tree.py: Write metres",
        "store/urdf_elements.py: Write radians",
        "store/urdf.py: Write metres here",
    ],
    "test_a_size_that_is_not_the_images_is_refused": [
        "ops/calibration/cell.py: --right-size of the right one; give frames"
    ],
    "test_a_fault_is_refused_and_the_recording_without_it_is_the_cure": [
        "calibrate/cell/rounds.py: See that the target's lights shine",
        "calibrate/cell/rounds.py: Check that --model is of this arm and its signs",
        "calibrate/cell/rounds.py: Switch off the mirroring",
    ],
    "test_points_that_are_no_such_board_are_refused_by_what_they_miss": [
        "calibrate/cameras/board_shape.py: Check what --board says"
    ],
    "test_resume_does_what_is_missing_changed_or_failed_by_chance": [
        "armsight_lab/batch/run.py: Begin it again, then give --resume"
    ],
    "test_nobody_answers": ["drivers/remote/wire.py: Check that `armsight serve` runs there"],
    "test_a_port_in_use_is_told": ["armsight_plant/opcua/publisher.py: Choose another port or address with --opcua"],
    "test_a_full_disk_ends_the_batch_and_keeps_what_is_done": [
        "armsight_lab/batch/work.py: Make room, then give --resume"
    ],
    "test_simulated_runs_are_a_batch_and_beside_the_forecast": [
        "armsight_lab/design/simulate.py: Give --board and --views"
    ],
    "test_the_method_of_the_paper_is_refused_where_it_is_useless": ["ops/identification/solve.py: Use --method ml"],
    "test_the_result_is_the_commands_and_all_of_it_is_used_at_once": ["app/guided/cell.py: Bring the controller's log"],
    "test_a_browser_prints_it_with_its_plot": ["cli/files.py: Give --pdf"],
    "test_one_of_two_tools_is_asked_for_and_the_cure_names_it": ["store/urdf_tree.py: with --tip, such as"],
    "test_a_rig_in_another_unit_is_named_and_its_cure_works": [
        "measure/consistency/other_setups.py: Multiply xyz_m of both cameras"
    ],
    "test_a_job_whose_worker_is_killed_is_done_again_and_one_that_kills_three_is_done_by_one_as_its_cure_says": [
        "armsight_lab/batch/work.py: fewer workers at once (--jobs)"
    ],
    "test_a_command_that_ends_in_a_crash_or_without_memory_ends_its_job_alone": [
        "armsight_lab/cli/batch_commands.py: Give fewer workers (--jobs)"
    ],
    "test_readings_that_count_from_other_places_are_named_and_the_cure_works": [
        "calibrate/arm/senses.py: In an arm.yaml (`armsight convert arm` writes one)"
    ],
    "test_a_target_whose_file_says_another_size_is_refused_and_its_size_as_built_is_the_cure": [
        "calibrate/cell/calibrate.py: Check that --model is this arm"
    ],
    "test_of_lights_that_look_alike_the_one_that_a_mask_leaves_is_the_beacon": [
        "measure/poses/beacon.py: cover or mask the others (--mask)"
    ],
    "test_the_diameter_tells_the_beacon_from_other_lights_where_lamps_are_masked": [
        "measure/poses/beacon.py: or give diameter_m in target.yaml"
    ],
    "test_a_length_typed_wrong_is_refused": [
        "calibrate/arm/touch/faults.py: Measure it again, and look whether the names"
    ],
    "test_a_height_that_is_not_needed_is_refused": [
        "calibrate/handeye/calibrate.py: Leave --target-height away",
        "ops/calibrate_hand_eye.py: Give the poses as --pairs, or no height",
    ],
    "test_without_a_height_what_is_known_is_told_and_what_is_open_named": [
        "calibrate/handeye/one_axis.py: give it with --target-height"
    ],
    "test_gross_pairs_are_left_out_and_a_wrong_setup_is_refused": ["calibrate/handeye/one_axis.py: Check --setup"],
    "test_a_finger_beside_a_fixed_tool_is_no_joint_of_the_arm_unasked": [
        "store/urdf_tree.py: Name the last link of the chain you mean with --tip: {}"
    ],
    "test_what_offsets_need_is_refused_with_the_line_to_add": ["drivers/linuxcnc/driver.py: Give its file with --arm"],
    "test_what_is_refused_is_written_once_its_cure_is_followed": [
        "control/paths/linuxcnc.py: with --controller",
        "control/paths/linuxcnc.py: Lower the path's speed",
        "control/paths/linuxcnc.py: begin from another posture (--start)",
        "ops/path/export.py: Give the arm (--arm), and what its joints may",
    ],
    "test_the_ids_that_are_there_and_the_speed_that_is_told_open_it": [
        "drivers/servo_bus/found.py: (--robot-set ids=)",
        "drivers/servo_bus/found.py: Give --robot-set baud={}",
    ],
    "test_ranges_of_the_servos_hold_and_those_of_another_zero_are_refused": [
        "drivers/servo_bus/robot.py: Name the arm's servos alone"
    ],
    "test_a_direction_that_is_not_the_files_is_refused_and_signs_are_the_cure": [
        "drivers/servo_bus/robot.py: or signs and zero_steps"
    ],
    "test_the_list_and_the_guide_name_every_kind_that_is_known": [
        "ops/file_kinds.py: All kinds are in armsight convert --list"
    ],
    "test_a_lens_that_sees_further_than_a_camera_here_is_refused_or_taken_in_part": [
        "store/foreign/lenses.py: Take the rest of the picture with --approximate"
    ],
    "test_matlabs_pair_is_read_with_its_own_conventions": [
        "store/foreign/matlab.py: Leave --unit out, or correct WorldUnits",
        "store/foreign/matlab.py: Leave --size out",
    ],
    "test_what_matlabs_files_leave_open_is_asked_for": ["store/foreign/matlab.py: Give the size of the images"],
    "test_a_file_with_a_fault_is_refused_or_read_as_it_was_meant": [
        "store/foreign/numbers.py: Look for the unit there"
    ],
    "test_what_rs_enumerate_devices_prints_is_read": [
        "store/foreign/realsense.py: Give the size of the images that you record",
        "store/foreign/several.py: of those that stand apart",
    ],
    "test_a_rig_that_is_no_longer_so_is_not_built_on_until_it_is_mended": [
        "calibrate/cameras/extended.py: calibrate it again with --again"
    ],
}
"""By test: the cures, as module and words, that it follows, or shows the new data that they ask for."""
IN_TESTS = {tuple(cure.split(": ", 1)): test for test, cures_of_it in FOLLOWED_IN.items() for cure in cures_of_it}

ENTRIES = [*TRIED, *IN_TESTS]
FOLLOWED: set[frozenset[str]] = set()
"""Commands that worked, each by its flags."""


def of(module: str, words: str) -> list[Cure]:
    """Return the product's cures of a module that are these words, or hold them."""
    held = [cure for cure in cures_of(module) if words in cure.text]
    return [cure for cure in held if cure.text == words] or held


def given(cure: Cure, told: str) -> bool:
    """Whether a message ends with a cure, whatever stands in its places."""
    pattern = ".*".join(re.escape(part) for part in cure.text.split("{}"))
    return re.search(re.sub(r"\\?\s+", r"\\s+", pattern), told) is not None


def told_by(trial) -> str:
    """Return the refusal that ends a trial, empty where it succeeds. Commands before the last one have to succeed."""
    if callable(trial):
        try:
            trial()
        except ArmsightError as error:
            return str(error)
        return ""
    from armsight.cli.commands import app

    *before, last = trial.split(" && ") if isinstance(trial, str) else trial
    for step in before:
        told = told_by(step)
        assert not told, told
    if before:
        return told_by(last)
    words = shlex.split(last)
    done = CliRunner().invoke(app, words if "--" in words else [*words, "--json"])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return " ".join(done.stderr.split()) or "no word" if done.exit_code else ""


@pytest.mark.usefixtures("trial_folder")
@pytest.mark.parametrize("entry", TRIED, ids=" ".join)
def test_a_cure_that_is_followed_to_the_letter_works(entry):
    cause, cured = TRIED[entry]
    told = told_by(cause)
    assert given(*of(*entry), told), told
    words = cured.replace("{}", cause) if isinstance(cured, str) and isinstance(cause, str) else cured
    flags = frozenset(re.split(" (?=-|&)", words)) if isinstance(words, str) else frozenset()
    if flags not in FOLLOWED:  # several cures lead to one command
        told = told_by(words)
        assert not told, told
        FOLLOWED.update({flags} - {frozenset()})


def test_the_tests_that_follow_cures_are_there():
    files = (ROOT / "tests").rglob("test_*.py")
    there = {name for file in files for name in re.findall(r"^ *def (test_\w+)", file.read_text(), re.MULTILINE)}
    assert set(IN_TESTS.values()) <= there


def test_every_entry_is_of_a_cure_that_the_product_gives():
    assert not [entry for entry in IN_TESTS if not of(*entry)]
    assert not [entry for entry in TRIED if len(of(*entry)) != 1]


def test_flags_that_cures_name_are_flags_of_commands():
    flags = {"--help"}

    def add(command):
        flags.update(name for one in command.params for name in (*one.opts, *one.secondary_opts))
        for inner in getattr(command, "commands", {}).values():
            add(inner)

    from armsight.cli.commands import app

    add(typer.main.get_command(app))
    named = [(cure, flag) for cure in cures() for flag in re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", cure.text)]
    begun = {known for known in flags if known.startswith("--zoom-")}
    assert not [(cure, flag) for cure, flag in named if flag not in flags and not (flag == "--zoom-" and begun)]


def test_cures_without_a_trial_grow_no_more():
    every = cures()
    named = [cure for cure in every if cure.named]
    tried = {cure for entry in ENTRIES for cure in of(*entry)}
    untried = [cure for cure in named if cure not in tried]
    sys.stdout.write(f"{len(every)} cures, {len(named)} name a flag, a command or a unit, {len(tried)} are exercised\n")
    assert NAMES.search("Give --unit 0.001") and not NAMES.search("Correct it there")
    sys.stdout.write("".join(f"{c.module}: {c.text}\n" for c in untried))
    assert len(untried) <= UNTRIED, "follow the new cure in a test, and name it in this table"
