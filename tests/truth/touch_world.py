"""An arm that touches spikes, flats, balls and gauges: its own forward kinematics, postures found by Newton's steps.

Nothing of armsight's kinematics is used but the numbers of its data sheets (a, alpha, d, theta, beta rows).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

KEYS = ("a_m", "alpha_rad", "d_m", "theta_rad", "beta_rad")


def about_z(c, s):
    return np.array([[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def link_of(a, alpha, beta):
    """Return Tx(a) Rx(alpha) Ry(beta)."""
    c, s = np.cos(alpha), np.sin(alpha)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    c, s = np.cos(beta), np.sin(beta)
    T = np.eye(4)
    T[:3, :3], T[0, 3] = turn @ [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]], a
    return T


@dataclass(frozen=True)
class World:
    """A true arm of revolute joints (rows (n, 5): a, alpha, d, theta, beta; sense (n,) of each joint), its tip in the
    flange, and the standard deviations of a touch (m) and of a reading (rad)."""

    rows: np.ndarray
    sense: np.ndarray
    craig: bool
    tip: np.ndarray
    touch_m: float = 1e-4
    joint_rad: float = 2e-5

    def there(self, q):
        """Return the tip (3,), and its derivative (3, n) by the readings: each axis crossed with its lever."""
        T, axes = np.eye(4), []
        for (a, alpha, d, theta, beta), sense, reading in zip(self.rows, self.sense, q, strict=True):
            angle = theta + sense * reading
            link, drive = link_of(a, alpha, beta), about_z(np.cos(angle), np.sin(angle))
            drive[2, 3] = d
            T = T @ link if self.craig else T
            axes.append((sense * T[:3, 2], T[:3, 3]))
            T = T @ drive if self.craig else T @ drive @ link
        tip = T[:3, :3] @ self.tip + T[:3, 3]
        return tip, np.stack([np.cross(z, tip - at) for z, at in axes], axis=1)

    def posture(self, rng, place, near, reach=0.9):
        """Return readings of a posture at a place, found from a random start near some posture."""
        while True:
            q = near + rng.uniform(-reach, reach, len(near))
            for _ in range(30):
                tip, J = self.there(q)
                off = place - tip
                q = q + J.T @ np.linalg.solve(J @ J.T + 1e-6 * np.eye(3), off) * min(1.0, 0.2 / np.linalg.norm(off))
                if np.linalg.norm(off) < 1e-10:
                    break
            if np.linalg.norm(off) < 1e-9 and np.abs(q - near).max() < 1.6 * reach + 0.4:
                return q

    def touched(self, rng, places, near, reach=0.9):
        """Return readings (m, n) of touches of places (m, 3), each missed by a touch's noise, read with a joint's."""
        found = [self.posture(rng, place + rng.normal(0, self.touch_m, 3), near, reach) for place in places]
        return np.array(found) + rng.normal(0, self.joint_rad, (len(places), len(near)))


def true_rows(arm, rng, names, length_m, angle_rad):
    """Return an arm's rows (n, 5) off by drawn errors in what is named ('j2.a_m' ..), and these errors."""
    rows = np.array([[getattr(joint, key) for key in KEYS] for joint in arm.joints])
    off = {}
    for name in names:
        joint, key = name.split(".")
        k = [one.name for one in arm.joints].index(joint)
        off[name] = rng.normal(0.0, length_m if key.endswith("_m") else angle_rad)
        rows[k, KEYS.index(key)] += off[name]
    return rows, off


NEAR = {
    "irb120": (0.2, 0.3, 0.2, 0.3, 1.0, 0.2),
    "ur5e": (0.3, -1.3, 1.6, -1.6, -1.4, 0.4),
    "kr6": (0.2, -1.0, 1.3, 0.3, 0.8, 0.2),
    "iiwa14": (0.2, 0.7, 0.3, -1.2, 0.3, 0.9, 0.2),
    "panda": (0.2, 0.1, 0.3, -1.9, 0.3, 1.9, 0.5),
    "ur10": (0.3, -1.2, 1.5, -1.5, -1.4, 0.4),
}
"""Arms with a posture about which they touch things before them."""
TIP = np.array([0.03, -0.02, 0.12])


def two_spikes(world, rng, near, apart=0.27, each=25):
    """Return places (2, 3) of two spikes, and touches: readings (m, n) and the spike (m,) of each."""
    first = world.there(near)[0]
    side = rng.normal(0, 1, 3) * [1.0, 1.0, 0.3]
    spikes = np.array([first, first + apart * side / np.linalg.norm(side)])
    which = np.repeat([0, 1], each)
    return spikes, world.touched(rng, spikes[which], np.asarray(near)), which


def bound(world, q, which, spikes, names, joints, length_m, angle_rad, known_m):
    """Return the least standard deviations (k,) of what is named ('j2.a_m' ..) by the information of touches (m,) of
    spikes, of a distance known to known_m, and of the tolerances by which the errors were drawn (Van Trees 1968), by
    finite differences about the truth; tip and spikes are free."""
    columns = [(joints.index(name.split(".")[0]), KEYS.index(name.split(".")[1])) for name in names]
    sigma = np.array([length_m if name.endswith("_m") else angle_rad for name in names])

    def tips(rows, tip):
        moved = World(rows, world.sense, world.craig, tip)
        return np.array([moved.there(one)[0] for one in q])

    J = np.zeros((len(q), 3, len(names) + 3 + 3 * len(spikes)))
    step = 1e-6
    for i, (joint, key) in enumerate(columns):
        more, less = world.rows.copy(), world.rows.copy()
        more[joint, key] += step
        less[joint, key] -= step
        J[:, :, i] = (tips(more, world.tip) - tips(less, world.tip)) / (2 * step)
    for i in range(3):
        off = step * np.eye(3)[i]
        J[:, :, len(names) + i] = (tips(world.rows, world.tip + off) - tips(world.rows, world.tip - off)) / (2 * step)
    for row, k in enumerate(which):
        at = len(names) + 3 + 3 * k
        J[row, :, at : at + 3] = -np.eye(3)
    information = np.zeros((J.shape[2], J.shape[2]))
    for row, slopes in enumerate(J):
        by_q = world.there(q[row])[1]
        V = world.touch_m**2 * np.eye(3) + world.joint_rad**2 * by_q @ by_q.T
        information += slopes.T @ np.linalg.solve(V, slopes)
    information[: len(names), : len(names)] += np.diag(sigma**-2)
    apart = spikes[0] - spikes[1]
    along = np.concatenate([np.zeros(len(names) + 3), apart, -apart]) / np.linalg.norm(apart)
    information += np.outer(along, along) / known_m**2
    return np.sqrt(np.diag(np.linalg.inv(information)))[: len(names)]
