"""A ROS 2 node that labels clouds as they come. Only ``node`` imports ROS.

Private: other packages do not import it.
"""
