"""A folder that a program may only read."""

READ_ONLY = """
import os, sys
folder, *words = sys.argv[1:]
if os.geteuid() == 0:  # as systemd does with /etc; root may write whatever a mode says
    script = 'mount --bind "$0" "$0" && mount -o remount,ro,bind "$0" && exec "$@"'
    os.execvp("unshare", ["unshare", "-m", "sh", "-c", script, folder, *words])
os.chmod(folder, 0o555)
os.execv(words[0], words)
"""
"""A program, by `python -c`: its arguments are the folder and the program to run there."""
