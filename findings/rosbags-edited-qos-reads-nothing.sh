#!/usr/bin/env bash
# rosbags 0.11.9: where metadata.yaml offers another quality of service than the data file (people edit it to play a bag
# with another reliability), the reader counts the messages and yields none of them, without an error.
# Seen with Python 3.11 on Linux: "counted 3, read 0". Exits 1 where that has changed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m pip install --quiet --target "$folder/lib" rosbags==0.11.9 pyyaml==6.0.3
found=$(PYTHONPATH="$folder/lib" python3 - "$folder/run" <<'PY'
import sys
from pathlib import Path

import yaml
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

run, store = Path(sys.argv[1]), get_typestore(Stores.ROS2_HUMBLE)
String = store.types["std_msgs/msg/String"]
with Writer(run, version=9) as writer:
    topic = writer.add_connection("/chatter", String.__msgtype__, typestore=store)
    for i in range(3):
        writer.write(topic, i, store.serialize_cdr(String("hello"), String.__msgtype__))
text = yaml.safe_load((run / "metadata.yaml").read_text())
never = {"sec": 9223372036, "nsec": 854775807}
about = text["rosbag2_bagfile_information"]["topics_with_message_count"][0]["topic_metadata"]
about["offered_qos_profiles"] = [
    {
        "history": "keep_last",
        "depth": 5,
        "reliability": "reliable",
        "durability": "volatile",
        "deadline": never,
        "lifespan": never,
        "liveliness": "automatic",
        "liveliness_lease_duration": never,
        "avoid_ros_namespace_conventions": False,
    }
]
(run / "metadata.yaml").write_text(yaml.safe_dump(text))
with AnyReader([run], default_typestore=store) as reader:
    print(f"counted {reader.message_count}, read {len(list(reader.messages()))}")
PY
)
echo "$found"
test "$found" = "counted 3, read 0"
