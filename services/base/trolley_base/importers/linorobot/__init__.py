"""What a linorobot's own files say of the robot, for `trolley import linorobot`."""
