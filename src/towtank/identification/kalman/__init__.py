"""The joint Kalman filter over motion, disturbance and coefficients, and its passes over recordings."""
