"""The planar car held against PyBullet: motion, senses, contact, and how episodes end."""
