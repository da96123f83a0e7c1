"""Samples to messages and back, a file per kind of sensor. Messages are stock ROS 2 types in CDR."""
