"""Black-box examination of one gate: what is known to be wrong stops the firmware.

Nothing here imports what it judges. Projects are written into folders, the command line runs on
them, and only its exit code and its JSON are read. All sensors but those of `real_files` are
simulated.
"""
