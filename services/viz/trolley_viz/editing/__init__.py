"""What a person is editing before it is sent: a tour, a queue of goals, the steps to undo."""
