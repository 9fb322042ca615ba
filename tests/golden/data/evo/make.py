"""Makes evo.json from the two TUM files, with evo 1.38.1 in an environment of its own."""

import json
from pathlib import Path

import evo
from evo.core import metrics, sync
from evo.tools import file_interface

HERE = Path(__file__).parent
PARTS = {"translation": metrics.PoseRelation.translation_part, "angle": metrics.PoseRelation.rotation_angle_rad}


def main() -> None:
    out: dict[str, object] = {"evo": evo.__version__}
    for aligned in (False, True):
        tracks = [file_interface.read_tum_trajectory_file(str(HERE / f"{n}.tum")) for n in ("reference", "estimate")]
        reference, estimate = sync.associate_trajectories(*tracks)
        if aligned:
            estimate.align(reference)
        for name, part in PARTS.items():
            found = {f"ape_{name}{'_aligned' * aligned}": metrics.APE(part)}
            if not aligned:
                for step in (1, 3):
                    found[f"rpe_{name}_{step}"] = metrics.RPE(part, step, metrics.Unit.frames, all_pairs=True)
            for key, metric in found.items():
                metric.process_data((reference, estimate))
                rmse = metric.get_statistic(metrics.StatisticsType.rmse)
                out[key] = {"rmse": rmse, "errors": [float(value) for value in metric.error]}
    (HERE / "evo.json").write_text(json.dumps(out, indent=1) + "\n")


if __name__ == "__main__":
    main()
