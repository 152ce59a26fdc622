"""ZebraT in Bullet: a car that learns to drive itself out of narrow spaces.

Importing the package is cheap: PyBullet, Open3D, torch and VTK load only with the modules that need them.
"""

__version__ = "0.1.0"
