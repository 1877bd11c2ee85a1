"""Glucose sensors: small objects around one another."""

from glucoloop.sensors.dead_time import DeadTime, dead_time
from glucoloop.sensors.ideal import IdealSensor
from glucoloop.sensors.protocol import Reading, Sensor
from glucoloop.sensors.white_noise import WhiteNoise, white_noise

__all__ = ["DeadTime", "IdealSensor", "Reading", "Sensor", "WhiteNoise", "dead_time", "white_noise"]
