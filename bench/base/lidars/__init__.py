"""Each lidar's bytes and a plain decoder of them: what drivers and emulators are judged by."""
