"""What a user's own depth camera and trajectory are worth, measured on what two frames both see."""

from objgraph.sensor.measure import Sensor, SensorConfig, measure_sensor

__all__ = ["Sensor", "SensorConfig", "measure_sensor"]
