"""ORB-SLAM3."""
