"""The same car and worlds in MuJoCo, the second engine."""
