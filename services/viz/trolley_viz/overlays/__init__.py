"""Panels that programs put over the scene: text, menus, gauges and plots of what robots publish."""
