"""The joystick on the screen: a pad in the page, a socket of its own, and who holds it."""
