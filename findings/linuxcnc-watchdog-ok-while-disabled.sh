#!/usr/bin/env bash
# LinuxCNC's HAL component watchdog, as in Debian 12 (linuxcnc-uspace 2.9.0~pre1+git20230208): watchdog(9) says of
# ok-out "true only if enable-in is TRUE and no timeout has been detected". It stays TRUE when enable-in falls, and a
# heartbeat that ends after that is not noticed until enable-in rises again. Who wires a session to enable-in and ok-out
# to what must fall with it has to gate ok-out by the session too.
# Seen: "enabled TRUE, disabled with the heartbeat ended TRUE, enabled again FALSE". Exits 1 where that has changed.
# It wants the package installed, an ordinary user, and no LinuxCNC running: halrun ends the realtime of any other.
set -euo pipefail
dpkg-query --show linuxcnc-uspace > /dev/null
! pgrep -x rtapi_app > /dev/null || { echo "a LinuxCNC runs on this computer" >&2; exit 2; }
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/watchdog.hal" <<'HAL'
loadrt threads name1=servo period1=1000000
loadrt charge_pump
loadrt watchdog num_inputs=1
addf charge-pump servo
addf watchdog.set-timeouts servo
addf watchdog.process servo
net heartbeat charge-pump.out => watchdog.input-0
setp watchdog.timeout-0 0.05
setp charge-pump.enable TRUE
start
setp watchdog.enable-in TRUE
loadusr -w sleep 0.5
getp watchdog.ok-out
setp watchdog.enable-in FALSE
loadusr -w sleep 0.5
setp charge-pump.enable FALSE
loadusr -w sleep 0.5
getp watchdog.ok-out
setp watchdog.enable-in TRUE
loadusr -w sleep 0.5
getp watchdog.ok-out
HAL
found=($(HOME=$folder RTAPI_FIFO_PATH=$folder/fifo halrun -f "$folder/watchdog.hal" 2> "$folder/log" | grep -E '^(TRUE|FALSE)$')) ||
    { cat "$folder/log" >&2; exit 2; }
seen="enabled ${found[0]}, disabled with the heartbeat ended ${found[1]}, enabled again ${found[2]}"
echo "$seen"
test "$seen" = "enabled TRUE, disabled with the heartbeat ended TRUE, enabled again FALSE"
