"""ZebraT in Bullet: a car that learns to drive itself out of narrow spaces.

Importing the package registers the gymnasium ids (`ZebraT/BigTrack-v0`, ...) and is otherwise cheap: PyBullet,
Open3D, torch and VTK load only with the modules that need them.
"""

from contextlib import suppress

__version__ = "0.1.0"

with suppress(ImportError):  # a trained policy can be run where gymnasium is not installed
    from zebrat_bullet.envs.registration import register_envs

    register_envs()
