"""One lane through time: Runge-Kutta steps that stop at every contact change."""
