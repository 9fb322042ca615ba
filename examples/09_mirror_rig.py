"""One camera and four mirrors: a single image holds both views, so there is no right one."""

import armsight

cell = armsight.simulate("pachidis2005-circle", frames=1, room="dark")
frame = next(iter(cell))
result = armsight.estimate_pose(frame.left, None, cell.rig, cell.target)
print(result)
