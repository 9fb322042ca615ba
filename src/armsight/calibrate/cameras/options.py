"""What a calibration from boards is free to do."""

from __future__ import annotations

from dataclasses import dataclass, replace

from armsight.errors import UsageError
from armsight.optics import LensKind
from armsight.optics.camera import INTRINSICS_OF


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardOptions:
    """Options of calibrate_camera and calibrate_stereo.

    fixed: intrinsics held at their start (zero for skew and distortion, the image's middle for cx and cy).
    automatic_k3: hold k3 at zero unless the data ask for it (by a score test); of a fisheye lens k3 and k4. lens: of
    the camera, or of both. right_lens: of a pair's right camera, where it is another. reject: leave out views and
    points that do not fit the others, and say so. folds: of the left-out error (0: none; as many as views: leave one
    out).
    """

    fixed: frozenset[str] = frozenset({"skew"})
    automatic_k3: bool = True
    reject: bool = True
    folds: int = 5
    max_iterations: int = 60
    lens: LensKind = LensKind.PINHOLE
    right_lens: LensKind | None = None

    @property
    def lenses(self) -> tuple[LensKind, LensKind]:
        """The lenses of the left camera, or the only one, and of the right one."""
        return self.lens, self.right_lens or self.lens

    def of_camera(self, c: int) -> BoardOptions:
        """Return the options for camera c of a pair alone."""
        return replace(self, lens=self.lenses[c], right_lens=None)

    def __post_init__(self) -> None:
        every = [name for lens in self.lenses for name in INTRINSICS_OF[lens]]
        names = [name for name in dict.fromkeys(every) if name != "none"]
        unknown = set(self.fixed) - set(names)
        if unknown:
            raise UsageError(
                f"no intrinsic is called {', '.join(sorted(unknown))}; there are {', '.join(names)}",
                consequence="Nothing was calibrated",
            )
        if self.folds < 0 or self.folds == 1 or self.max_iterations < 1:
            raise UsageError(f"{self.folds} folds with {self.max_iterations} iterations make no sense")
