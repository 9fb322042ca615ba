"""Complex images of a board, or of the lit target, in; a mirror rig, or what is wrong with its mirrors, out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from armsight.app.calibrate.board_images import in_parallel, see_board, see_two_boards
from armsight.app.calibrate.board_pictures import BoardPictures
from armsight.app.calibrate.camera_noise import input_files
from armsight.app.calibrate.mirrors_lit_target import calibrate_lit, reasons
from armsight.app.calibrate.reports import alignment_lines, write_stereo_report
from armsight.app.calibrate.results import MirrorsOutput, PlateOutput
from armsight.app.requests.calibrate_cameras import MirrorsJob
from armsight.app.sources.frames import open_source
from armsight.calibrate.cameras import BoardOptions
from armsight.calibrate.mirrors.calibration import MirrorCalibration, calibrate_mirrors
from armsight.drivers import is_live
from armsight.errors import Cancelled, Inconsistent, NotEnoughData, Unseen, UsageError
from armsight.optics import Plate, Rig
from armsight.optics.mirrors import FormError, Mirrors, form_errors
from armsight.records import BoardView, Frame, NotSeen, Progress, Silent, Target
from armsight.records.output import extended
from armsight.records.result_parts import RejectedFile
from armsight.store import parse_board, read_camera, read_target, write_rig

TITLE = "Calibration of a mirror rig"

DEPTHS_M = (0.4, 0.5, 0.6, 0.7, 0.8)
LEAST_BOARDS = 3
"""Images of the board below which nothing is calibrated."""

CURES: Mapping[Unseen, str] = {
    Unseen.BEYOND_SIZE: "Check the counts of --board, or look for a third reflection of the board",
    Unseen.THRICE: "Look for a third reflection: show the board once in each view",
    Unseen.ONLY_ONCE: "Open both paths; where each image shows one view, give --left-only and --right-only",
    Unseen.IN_PART: "Show the whole board in both views",
    Unseen.BLURRED: "Hold the board still, shorten the exposure or focus the lens",
}
"""What helps against what kept the board from being seen."""
OTHER_CURE = "Show the whole board in both views, lit evenly, and check the counts of --board"

Pair = tuple[BoardView, BoardView]
Missed = tuple[str, NotSeen]
"""Which image, and why."""


def run_mirrors(job: MirrorsJob, progress: Progress | None = None) -> MirrorsOutput:
    """Calibrate a mirror rig and write its rig.yaml; return the figures as --json gives them.

    Raises UsageError, DataRefused or DeviceFailed, Cancelled.
    """
    progress = progress or Silent()
    if job.out is None:
        raise UsageError("there is no file to write", cure="Give -o rig.yaml")
    if job.target is not None:
        return _from_target(job, job.out, progress)
    board = parse_board(board_name(job))
    pictures = BoardPictures()
    views, missed = _all_pairs(job, board, progress, pictures)
    if len(views) < LEAST_BOARDS:
        raise _too_few(job, len(views), missed)
    progress.update(0, 0, "solving")
    done = calibrate_mirrors(
        [left for left, _ in views],
        [right for _, right in views],
        board,
        thickness_m=job.thickness_m,
        index=job.index,
        options=BoardOptions(folds=job.folds),
        progress=progress,
    )
    write_rig(job.out, done.rig, inputs=_inputs(job))
    forms = _forms(done)
    result = mirrors_output(done, [RejectedFile(source, seen.why) for source, seen in missed], forms=forms)
    lines = [*alignment_lines(result), *_results(done, forms)]
    write_stereo_report(job.out, result, board, pictures, shown=job.board, title=TITLE, alignment=lines)
    return result


def _too_few(job: MirrorsJob, n: int, missed: Sequence[Missed]) -> NotEnoughData:
    """Return the refusal of too few images that show the board in both views, with the commonest reasons."""
    total = n + len(missed)
    found = reasons([seen for _, seen in missed])
    said = "; ".join(f"{seen.why} (in {count})" for seen, count in found[:3])
    cure = "Take ten to twenty images, with the board tilted in different directions"
    if found:
        cure = CURES.get(found[0][0].cause, OTHER_CURE)
    counted = f"{n or 'none'} of {total} image{'' if total == 1 else 's'} show{'s' if n == 1 else ''}"
    return NotEnoughData(
        f"{counted} the board {job.board} in both views, {LEAST_BOARDS} are needed" + (f": {said}" if said else ""),
        consequence="Nothing was calibrated",
        cure=cure,
    )


def mirrors_output(
    done: MirrorCalibration, missed: Sequence[RejectedFile], *, forms: Sequence[FormError] = ()
) -> MirrorsOutput:
    """Return a mirror rig's calibration; missed: what was not seen in both views."""
    pair, plate = done.pair, done.rig.left.plate
    return extended(
        pair,
        MirrorsOutput,
        n_pairs=pair.n_pairs + len(missed),
        rejected=(*missed, *pair.rejected),
        metric=pair.metric or dict.fromkeys(("expected_m", "mean_m", "rms_m")),
        plate=PlateOutput(
            m_m=done.shift_m,
            l_m=done.shift_m,
            thickness_m=0.0 if plate is None else plate.thickness_m,
            index=None if plate is None else plate.index,
            seen_thickness_m=done.seen_m,
            seen_thickness_std_m=done.seen_std_m,
        ),
        one_lens=done.one_lens,
        forms=list(forms),
    )


def board_name(job: MirrorsJob) -> str:
    """Return the board. Raises UsageError where none is given."""
    if not job.board:
        raise UsageError("there is no board", cure="Give --board, for instance checkerboard:9x6:0.025")
    return job.board


def _all_pairs(
    job: MirrorsJob, board: Target, progress: Progress, pictures: BoardPictures
) -> tuple[list[Pair], list[Missed]]:
    """Return the board in both views of every image, and the images in which it is not."""
    if job.image is None and (job.left_only is None or job.right_only is None):
        raise _no_images(job)
    views: list[Pair] = []
    missed: list[Missed] = []
    sources = ([complex_views(job, board, pictures)] if job.image is not None else []) + (
        [_covered(job, board, pictures)] if job.left_only is not None or job.right_only is not None else []
    )
    for source in sources:
        for name, seen in source:
            if isinstance(seen, NotSeen):
                missed.append((name, seen))
            else:
                views.append(seen)
            progress.update(len(views) + len(missed), job.limit or 0, "finding the board")
            if progress.cancelled():
                raise Cancelled("stopped", consequence="Nothing was written")
    return views, missed


def _no_images(job: MirrorsJob) -> UsageError:
    """Return the refusal that names which source is missing."""
    if job.left_only is None and job.right_only is None:
        return UsageError("there are no images", cure="Give --image, or --left-only and --right-only")
    given, missing = ("--left-only", "--right-only") if job.right_only is None else ("--right-only", "--left-only")
    return UsageError(
        f"{given} is given without {missing}",
        cure=f"Give {missing} too, with the images of the same places of the board, or --image with complex images",
    )


def complex_views(job: MirrorsJob, board: Target, pictures: BoardPictures) -> Iterator[tuple[str, Pair | NotSeen]]:
    """Yield each complex image's name with the board in both of its views, or why there are not two."""

    def see(frame: Frame) -> tuple[str, Pair | NotSeen]:
        return frame.source, see_two_boards(frame, board, pictures)

    stop = None if job.limit is None else job.limit * job.every
    with open_source(job.image or "", settings=job.camera_settings) as frames:
        yield from in_parallel(see, islice(frames, 0, stop, job.every), workers=job.workers)


def _covered(job: MirrorsJob, board: Target, pictures: BoardPictures) -> Iterator[tuple[str, Pair | NotSeen]]:
    """Yield the pairs of images taken with one path covered after the other."""
    if job.left_only is None or job.right_only is None:
        raise _no_images(job)
    opened = partial(open_source, settings=job.camera_settings)
    with opened(job.left_only) as lefts, opened(job.right_only) as rights:
        if lefts.total != rights.total:
            raise Inconsistent(
                f"{lefts.total} images of the left view and {rights.total} of the right one do not pair up",
                consequence="Nothing was calibrated",
                cure="Cover one path after the other at every place of the board",
            )
        for left, right in zip(lefts, rights, strict=True):
            seen = [see_board(frame, board, pictures=pictures) for frame in (left, right)]
            lost = [
                (frame.source, one) for frame, one in zip((left, right), seen, strict=True) if isinstance(one, NotSeen)
            ]
            both = [one for one in seen if isinstance(one, BoardView)]
            yield left.source, _joined(lost) if lost else (both[0], both[1])


def _joined(lost: Sequence[Missed]) -> NotSeen:
    """Return what was not seen in one image or two as one reason; its cause is the first that has a cure of its own."""
    causes = [one.cause for _, one in lost if one.cause in CURES]
    return NotSeen("; ".join(f"{source}: {one.why}" for source, one in lost), causes[0] if causes else Unseen.OTHER)


def _from_target(job: MirrorsJob, out: Path, progress: Progress) -> MirrorsOutput:
    """Calibrate the mirrors from complex images of the lit target; the lens comes from camera.yaml."""
    if job.board:
        raise UsageError("--target and --board are both given", cure="Give the one that the images show")
    if job.left_only is not None or job.right_only is not None:
        raise UsageError("--target goes with complex images only", cure="Give --image, or covered views with --board")
    design, target = lit_design(job)
    if job.image is None or job.camera is None or job.target is None or job.baseline_m is None:
        raise _incomplete(job)
    images = partial(open_source, job.image, settings=job.camera_settings)
    done, missed = calibrate_lit(design, target, images, every=job.every, limit=job.limit, progress=progress)
    write_rig(out, done.rig, inputs=[job.camera, job.target, *_inputs(job)])
    forms = _forms(done)
    result = replace(mirrors_output(done, missed, forms=forms), lit=True)
    write_stereo_report(
        out,
        result,
        target,
        BoardPictures(),
        shown=str(job.target),
        title=TITLE,
        alignment=[*alignment_lines(result), *_results(done, forms)],
        facts=[("camera's file", job.camera.name), ("baseline as designed", f"{1e3 * job.baseline_m:g} mm")],
    )
    return result


def lit_design(job: MirrorsJob) -> tuple[Rig, Target]:
    """Return the rig as it was designed, its lens known, and the lit target. Raises UsageError, BadFile."""
    if job.camera is None or job.baseline_m is None or job.target is None:
        raise _incomplete(job)
    camera, target = read_camera(job.camera), read_target(job.target)
    plate = Plate(thickness_m=job.thickness_m or 1e-3, index=job.index)
    design = Mirrors(baseline_m=job.baseline_m, near_m=job.near_m, gap_m=job.gap_m, plate=plate).rig(camera)
    if job.thickness_m == 0.0:
        design = replace(design, left=replace(design.left, plate=None))
    return design, target


def _incomplete(job: MirrorsJob) -> UsageError:
    """Return the refusal that names which options a calibration from the lit target still needs."""
    needed = {
        "--camera": (job.camera, "camera.yaml, the lens"),
        "--baseline-mm": (job.baseline_m, "the baseline as designed"),
        "--image": (job.image, "the complex images"),
    }
    missing = {name: what for name, (given, what) in needed.items() if given is None}
    return UsageError(
        f"{' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing: "
        "the lit target alone does not tell the rig",
        cure=f"Give {' and '.join(f'{name} ({what})' for name, what in missing.items())}",
    )


def _forms(done: MirrorCalibration) -> tuple[FormError, ...]:
    """Return how far the paper's equations would be off with this rig, from 400 to 800 mm."""
    plate = done.rig.left.plate
    if plate is None:
        return ()
    side = np.linspace(-0.12, 0.12, 9)
    grid = np.stack(np.meshgrid(side, 0.75 * side, DEPTHS_M, indexing="ij"), axis=-1).reshape(-1, 3)
    lens = replace(done.rig.left, plate=None)
    return form_errors(lens, Mirrors(baseline_m=done.rig.baseline_m, plate=plate), grid)


def _results(done: MirrorCalibration, forms: Sequence[FormError]) -> list[tuple[str, str]]:
    """Return the plate and how far the paper's equations are off, in words."""
    plate = done.rig.left.plate
    if done.seen_m is not None and done.seen_std_m is not None:
        lines = [("glass plate, as the views show it", f"{1e3 * done.seen_m:.2f} +- {1e3 * done.seen_std_m:.2f} mm")]
    else:
        lines = [("glass plate, as given", "none" if plate is None else f"{1e3 * plate.thickness_m:g} mm")]
    lines.append(("its shift of the left view, m and l", f"{1e3 * done.shift_m:.4f} mm"))
    lines += [
        (f"triangulation off by, {one.name}", f"{1e3 * one.z_m:.3g} mm in depth, {one.epipolar_px:.2g} px across")
        for one in forms
    ]
    return lines


def _inputs(job: MirrorsJob) -> list[Path]:
    texts = [text for text in (job.image, job.left_only, job.right_only) if text is not None and not is_live(text)]
    return [path for text in texts for path in input_files(text)]
