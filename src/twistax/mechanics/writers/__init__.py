"""Writers of mechanisms as text: URDF and MJCF."""
