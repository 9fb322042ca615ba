"""Forward and inverse kinematics, the Jacobian against differences, and joints along a path."""

import numpy as np

import armsight

arm = armsight.presets.ur10()  # or armsight.read_arm("arm.urdf")
q = np.array([0.3, -1.2, 1.4, -0.5, 1.2, 0.4])
T = arm.fk(q)
answer = arm.ik(T, near=q)  # all solutions, nearest first
print(f"{answer.status}: {len(answer.solutions)} solutions, q off by {abs(answer.solutions[0].q - q).max():.1e} rad")
assert all(np.allclose(arm.fk(solution.q), T, atol=1e-6) for solution in answer.solutions)

step = 1e-6 * np.eye(6)
differences = (arm.fk(q + step)[:, :3, 3] - arm.fk(q - step)[:, :3, 3]).T / 2e-6
print(f"Jacobian off differences by {abs(arm.jacobian(q)[:3] - differences).max():.1e} m/rad")
assert np.allclose(arm.jacobian(q)[:3], differences, atol=1e-7)

line = np.tile(T, (50, 1, 1))
line[:, 2, 3] += np.linspace(0.0, 0.2, 50)  # straight up
track = arm.track(line, t_s=np.linspace(0.0, 2.0, 50), near=q)
left_mm = 1e3 * abs(arm.fk(track.q)[:, :3, 3] - line[:, :3, 3]).max()
print(f"path complete: {track.complete}, {len(track.issues)} issues, left by {left_mm:.1e} mm")
assert track.complete and left_mm < 1e-3
