"""A cell from a changed scenario, rendered and measured: where the truth is known, claimed deviations can be judged."""

import numpy as np

import armsight

print(*armsight.scenarios())
scenario = armsight.read_scenario("webcam-cell")  # a dictionary, as docs/guide/simulate.md describes it
scenario["cameras"]["exposure_s"] = 0.002
scenario["room"] = "dark"
cell = armsight.simulate({**scenario, "seed": 7}, frames=24)
frames = list(cell)
left, right = [f.left for f in frames], [f.right for f in frames]
done = armsight.measure(cell.rig, cell.target, left, right, times={"t_s": cell.t_s})

table = done.poses.table()
error_m = done.poses.T_parent_target[:, :3, 3] - cell.T_rig_target[:, :3, 3]
std_m = np.transpose([table[name] for name in ("sx_m", "sy_m", "sz_m")])
rms_mm, claimed_mm = (1e3 * np.sqrt(np.mean(x**2, axis=0)) for x in (error_m, std_m))
print(f"{done.n_ok} of 24 poses, off the truth by {rms_mm.round(3)} mm RMS; claimed +- {claimed_mm.round(3)} mm")
within = np.mean(abs(error_m) < 1.96 * std_m)
print(f"{100 * within:.0f} % of errors are within 1.96 standard deviations (95 % should be)")
assert done.n_ok == 24 and within > 0.85
