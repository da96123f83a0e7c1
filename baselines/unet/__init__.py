"""A small U-Net: where oysters are, and one by one."""
