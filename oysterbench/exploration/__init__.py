"""Exploring a reef by commands of yaw and pitch: rollouts of policies, and what they are compared with."""
