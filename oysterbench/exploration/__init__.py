"""Exploration of a reef by yaw and pitch commands: rollouts of policies, and the references they are compared with."""
