"""Trackers' files as their programs write them, made of poses and points by formulas of this file alone.

Takes are frames at a rate: bodies by name as (rotation, (n, 3) m), markers by name as (n, 3) m, NaN where lost.
"""

import struct
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(kw_only=True)
class Take:
    rate: float
    bodies: dict = field(default_factory=dict)
    markers: dict = field(default_factory=dict)

    @property
    def n(self):
        return len(next(iter([*self.markers.values(), *(xyz for _, xyz in self.bodies.values())])))


def cells(values, digits=6):
    return ["" if value != value else f"{value:.{digits}f}" for value in np.ravel(values)]


def text(lines, by, end="\n"):
    return end.join(by.join(line) for line in lines) + end


def motive(take):
    """Format 1.25 as Motive 3 writes it: type, name, ID, parent, kind, axis; quaternions X, Y, Z, W; mm."""
    kinds, names, ids, parents, what, axes = ["", "Type"], ["", "Name"], ["", "ID"], ["", "Parent"], ["", ""], []
    for k, name in enumerate(take.bodies):
        kinds += ["Rigid Body"] * 8
        names, ids, parents = names + [name] * 8, ids + [f"{k:X}AF01"] * 8, parents + [""] * 8
        what += ["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]
        axes += [*"XYZWXYZ", ""]
    for k, name in enumerate(take.markers):
        kinds, what, axes = kinds + ["Marker"] * 3, what + ["Position"] * 3, [*axes, *"XYZ"]
        names, ids, parents = names + [name] * 3, ids + [f"B{k:X}02"] * 3, parents + [name.partition(":")[0]] * 3
    said = {"Format Version": "1.25", "Take Name": "Take 2026-01-05", "Capture Frame Rate": f"{take.rate:.6f}"}
    said |= {"Export Frame Rate": f"{take.rate:.6f}", "Capture Start Time": "2026-01-05 10.00.00.000 AM"}
    said |= {"Total Frames in Take": str(take.n), "Total Exported Frames": str(take.n)}
    said |= {"Rotation Type": "Quaternion", "Length Units": "Millimeters", "Coordinate Space": "Global"}
    lines = [[cell for pair in said.items() for cell in pair], [], kinds, names, ids, parents, what]
    lines.append(["Frame", "Time (Seconds)", *axes])
    for k in range(take.n):
        lines.append([str(k), *cells(k / take.rate)])
        for R, xyz in take.bodies.values():
            there = np.isfinite(xyz[k]).all()
            lines[-1] += cells([*R[k].as_quat(), *(1e3 * xyz[k]), 0.2]) if there else [""] * 8
        for xyz in take.markers.values():
            lines[-1] += cells(1e3 * xyz[k])
    return text(lines, ",", "\r\n")


def _qtm_head(take, included, *more):
    head = [["NO_OF_FRAMES", str(take.n)], ["NO_OF_CAMERAS", "12"], ["FREQUENCY", f"{take.rate:g}"]]
    return [*head, ["TIME_STAMP", "2026-01-05, 10:00:00.000", "4711.5"], ["DATA_INCLUDED", included], *more]


def qtm_6d(take):
    """mm; Roll, Pitch, Yaw of R = Rx Ry Rz; the matrix column by column; zeros where lost."""
    lines = _qtm_head(take, "6D", ["BODY_NAMES", *take.bodies])
    lines.append(["Frame", "Time"])
    for name in take.bodies:
        lines[-1] += [f"{name} X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{i}]" for i in range(9))]
    for k in range(take.n):
        lines.append([str(k + 1), *cells(k / take.rate, 5)])
        for R, xyz in take.bodies.values():
            if not np.isfinite(xyz[k]).all():
                lines[-1] += ["0.000"] * 16
                continue
            angles = R[k].as_euler("XYZ", degrees=True)
            lines[-1] += cells([*(1e3 * xyz[k]), *angles, 0.2, *R[k].as_matrix().T.ravel()])
    return text(lines, "\t", "\r\n")


def qtm_3d(take):
    lines = _qtm_head(take, "3D", ["NO_OF_MARKERS", str(len(take.markers))], ["MARKER_NAMES", *take.markers])
    lines.append(["Frame", "Time", *(f"{name} {axis}" for name in take.markers for axis in "XYZ")])
    for k in range(take.n):
        xyz = np.nan_to_num(1e3 * np.array([one[k] for one in take.markers.values()]))
        lines.append([str(k + 1), *cells(k / take.rate, 5), *cells(xyz, 4)])
    return text(lines, "\t", "\r\n")


def vicon_objects(take):
    """Tracker 3: quaternions RX, RY, RZ, RW, mm."""
    columns = ["RX", "RY", "RZ", "RW", "TX", "TY", "TZ"]
    lines = [["Objects"], [f"{take.rate:g}"]]
    lines.append(["", "", *(cell for name in take.bodies for cell in (f"Global Angle {name}:{name}", *[""] * 6))])
    lines.append(["Frame", "Sub Frame", *columns * len(take.bodies)])
    lines.append(["", "", *([*[""] * 4, *["mm"] * 3] * len(take.bodies))])
    for k in range(take.n):
        lines.append([str(k + 1), "0"])
        for R, xyz in take.bodies.values():
            there = np.isfinite(xyz[k]).all()
            lines[-1] += cells([*R[k].as_quat(), *(1e3 * xyz[k])]) if there else [""] * 7
    return text(lines, ",", "\r\n")


def vicon_trajectories(take):
    lines = [["Trajectories"], [f"{take.rate:g}"]]
    lines.append(["", "", *(cell for name in take.markers for cell in (name, "", ""))])
    lines.append(["Frame", "Sub Frame", *[*"XYZ"] * len(take.markers)])
    lines.append(["", "", *["mm"] * 3 * len(take.markers)])
    lines += [[str(k + 1), "0", *cells([1e3 * xyz[k] for xyz in take.markers.values()])] for k in range(take.n)]
    return text(lines, ",", "\r\n")


def trc(take):
    lines = [["PathFileType", "4", "(X/Y/Z)", "take.trc"]]
    lines.append(["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate", "OrigNumFrames"])
    rate, count = f"{take.rate:.2f}", str(take.n)
    lines.append([rate, rate, count, str(len(take.markers)), "mm", rate, count])
    lines.append(["Frame#", "Time", *(cell for name in take.markers for cell in (name, "", ""))])
    lines.append(["", "", *(f"{axis}{k + 1}" for k in range(len(take.markers)) for axis in "XYZ")])
    lines.append([])
    rows = 1e3 * np.stack(list(take.markers.values()), axis=1)
    lines += [[str(k + 1), *cells(k / take.rate), *cells(row)] for k, row in enumerate(rows)]
    return text(lines, "\t", "\r\n")


def words(numbers, processor):
    return np.asarray(numbers).astype(">i2" if processor == 86 else "<i2").tobytes()


def floats(numbers, processor):
    if processor != 85:
        return np.asarray(numbers, np.float32).astype(">f4" if processor == 86 else "<f4").tobytes()
    halves = (4.0 * np.asarray(numbers, np.float32)).astype("<f4").view("<u2").reshape(-1, 2)  # exponents by 2 more
    return np.ascontiguousarray(halves[:, ::-1]).tobytes()


def c3d(take, processor=84, scale=-0.1):
    """As the format's guide says, of a processor (84 Intel, 85 DEC, 86 MIPS); scale < 0: floating point; mm."""
    points = 1e3 * np.stack(list(take.markers.values()), axis=1)  # (n, k, 3)
    n, count = points.shape[:2]
    wide = max(map(len, take.markers))
    labels = b"".join(name.encode().ljust(wide) for name in take.markers)
    value = {
        "USED": (2, [], words([count], processor)),
        "SCALE": (4, [], floats([scale], processor)),
        "RATE": (4, [], floats([take.rate], processor)),
        "DATA_START": (2, [], words([4], processor)),
        "FRAMES": (2, [], words([n], processor)),
        "UNITS": (-1, [2], b"mm"),
        "LABELS": (-1, [wide, count], labels),
    }
    parameters = struct.pack("BBBB", 1, 0x50, 1, processor)
    parameters += struct.pack("bb", 5, -1) + b"POINT" + words([3], processor) + b"\0"
    for name, (kind, shape, data) in value.items():
        body = struct.pack("bB", kind, len(shape)) + bytes(shape) + data + b"\0"
        parameters += struct.pack("bb", len(name), 1) + name.encode() + words([2 + len(body)], processor) + body
    parameters += bytes(1024 - len(parameters))
    head = struct.pack("BB", 2, 0x50) + words([count, 0, 1, n, 0], processor) + floats([scale], processor)
    head += words([4, 0], processor) + floats([take.rate], processor)
    lost = np.isnan(points).any(axis=2)
    rows = np.zeros((n, count, 4))
    rows[..., :3] = np.where(lost[..., None], 777.0, points / abs(scale) if scale > 0.0 else points)
    rows[..., 3] = np.where(lost, -1.0, 3 + 256 * 5)  # of five cameras, a residual of 3
    rows = np.round(rows) if scale > 0.0 else rows
    data = words(rows.ravel(), processor) if scale > 0.0 else floats(rows.ravel(), processor)
    return head.ljust(512, b"\0") + parameters + data + bytes(512)


def spatial_analyzer(take):
    """Points of one group in the order of the visits; the first marker's."""
    (name, xyz), *_ = take.markers.items()
    lines = ["// SpatialAnalyzer, ASCII points; units: Millimeters", "// Collection, Group, Point, X, Y, Z"]
    lines += [f"Cell, {name}, p{k + 1}, {', '.join(cells(1e3 * row))}" for k, row in enumerate(xyz)]
    return "\r\n".join([*lines, ""])


OF_BODIES = {"motive": motive, "qtm-6d": qtm_6d, "vicon-objects": vicon_objects}
OF_MARKERS = {"qtm-3d": qtm_3d, "vicon-trajectories": vicon_trajectories, "trc": trc, "c3d": c3d}
ENDINGS = {"motive": ".csv", "qtm-6d": "_6D.tsv", "qtm-3d": ".tsv", "vicon-objects": ".csv", "trc": ".trc"}
ENDINGS |= {"vicon-trajectories": ".csv", "c3d": ".c3d", "spatialanalyzer": ".txt"}


def written(folder, name, kind, take):
    """Write a take as the program of this kind does; return the file."""
    path = folder / f"{name}{ENDINGS[kind]}"
    content = (OF_BODIES | OF_MARKERS | {"spatialanalyzer": spatial_analyzer})[kind](take)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def turned_about(R, t, shape):
    """Markers of a body of a shape {name: (3,)}."""
    return {name: Rotation.as_matrix(R) @ np.asarray(place) + t for name, place in shape.items()}
