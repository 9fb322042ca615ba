"""LinuxCNC's side of armsight's link: a folder that Debian's own Python runs beside LinuxCNC, as its user.

It needs the standard library and LinuxCNC's module `hal`, and nothing of armsight:

    python3 linuxcnc_bridge hal INI [--bind ADDRESS] [--port N]    prints the HAL lines that belong to it
    python3 linuxcnc_bridge run INI [--bind ADDRESS] [--port N]    what those lines start

Every few servo cycles, counted by HAL's sampler, the state goes to the one program that opened the link; its answer, a
goal of all joints, is laid out at the servo rate and goes through HAL's streamer to the joints' jog counts, one braking
distance ahead. LinuxCNC's own planner comes behind, with its limits of speed, acceleration and position.
"""
