"""An arm that touches spikes, flats, balls and gauges: its own forward kinematics, postures found by Newton's steps.

Nothing of armsight's kinematics is used but the numbers of its data sheets (a, alpha, d, theta, beta rows).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

KEYS = ("a_m", "alpha_rad", "d_m", "theta_rad", "beta_rad")


def drives(angle, d):
    """Return Rz(angle) Tz(d) of angles (...)."""
    T = np.zeros((*np.shape(angle), 4, 4))
    T[..., 0, 0] = T[..., 1, 1] = np.cos(angle)
    T[..., 1, 0] = np.sin(angle)
    T[..., 0, 1] = -T[..., 1, 0]
    T[..., 2, 2] = T[..., 3, 3] = 1.0
    T[..., 2, 3] = d
    return T


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
        """Return the tip (..., 3) at readings (..., n), and its derivative (..., 3, n): each axis crossed with its
        lever."""
        q = np.asarray(q)
        T, axes = np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4)), []
        for k, ((a, alpha, d, theta, beta), sense) in enumerate(zip(self.rows, self.sense, strict=True)):
            link, drive = link_of(a, alpha, beta), drives(theta + sense * q[..., k], d)
            T = T @ link if self.craig else T
            axes.append((sense * T[..., :3, 2], T[..., :3, 3]))
            T = T @ drive if self.craig else T @ drive @ link
        tip = T[..., :3, :3] @ self.tip + T[..., :3, 3]
        z, at = (np.stack(one, axis=-2) for one in zip(*axes, strict=True))
        return tip, np.cross(z, tip[..., None, :] - at).swapaxes(-1, -2)

    def postures(self, rng, places, near, reach=0.9):
        """Return readings (m, n) of postures at places (m, 3), found from random starts near some posture."""
        found, left = np.zeros((len(places), len(near))), np.arange(len(places))
        while len(left):
            q = near + rng.uniform(-reach, reach, (len(left), len(near)))
            for _ in range(30):
                tip, J = self.there(q)
                off = places[left] - tip
                size = np.linalg.norm(off, axis=1)
                step = np.linalg.solve(J @ J.swapaxes(1, 2) + 1e-6 * np.eye(3), off[..., None])
                q += (J.swapaxes(1, 2) @ step)[..., 0] * np.minimum(1.0, 0.2 / np.maximum(size, 1e-12))[:, None]
            off = np.linalg.norm(places[left] - self.there(q)[0], axis=1)
            good = (off < 1e-9) & (np.abs(q - near).max(axis=1) < 1.6 * reach + 0.4)
            found[left[good]] = q[good]
            left = left[~good]
        return found

    def touched(self, rng, places, near, reach=0.9):
        """Return readings (m, n) of touches of places (m, 3), each missed by a touch's noise, read with a joint's."""
        found = self.postures(rng, places + rng.normal(0, self.touch_m, (len(places), 3)), np.asarray(near), reach)
        return found + rng.normal(0, self.joint_rad, found.shape)


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
    return spikes, world.touched(rng, spikes[which], near), which


def bound(world, q, which, spikes, off, joints, length_m, angle_rad, known_m, known_off_m=0.0):
    """Return of errors off ('j2.a_m': m ..) the least standard deviations (k,) by the information of touches (m,) of
    spikes, of a distance known to known_m, and off by known_off_m, and of the tolerances that errors were drawn by
    (Van Trees 1968); and how far off (k,) the estimate is that reaches them on these very rows: by finite differences
    about the truth, noises known; tip and spikes are free."""
    columns = [(joints.index(name.split(".")[0]), KEYS.index(name.split(".")[1])) for name in off]
    sigma = np.array([length_m if name.endswith("_m") else angle_rad for name in off])
    k = len(off)

    def tips(rows, tip):
        return World(rows, world.sense, world.craig, tip).there(q)[0]

    J = np.zeros((len(q), 3, k + 3 + 3 * len(spikes)))
    step = 1e-6
    for i, (joint, key) in enumerate(columns):
        more, less = world.rows.copy(), world.rows.copy()
        more[joint, key] += step
        less[joint, key] -= step
        J[:, :, i] = (tips(more, world.tip) - tips(less, world.tip)) / (2 * step)
    for i in range(3):
        by = step * np.eye(3)[i]
        J[:, :, k + i] = (tips(world.rows, world.tip + by) - tips(world.rows, world.tip - by)) / (2 * step)
    for row, spike in enumerate(which):
        J[row, :, k + 3 + 3 * spike :][:, :3] = -np.eye(3)
    tip, by_q = world.there(q)
    V = world.touch_m**2 * np.eye(3) + world.joint_rad**2 * by_q @ by_q.swapaxes(1, 2)
    weighed = np.linalg.solve(V, J)
    information = np.einsum("mij,mik->jk", J, weighed)
    gradient = np.einsum("mij,mi->j", weighed, tip - spikes[which])
    information[:k, :k] += np.diag(sigma**-2)
    gradient[:k] += np.array(list(off.values())) / sigma**2
    apart = spikes[0] - spikes[1]
    along = np.concatenate([np.zeros(k + 3), apart, -apart]) / np.linalg.norm(apart)
    information += np.outer(along, along) / known_m**2
    gradient -= along * known_off_m / known_m**2
    C = np.linalg.inv(information)
    return np.sqrt(np.diag(C))[:k], -(C @ gradient)[:k]
