"""The paper's method: filtered regressors, exact in discrete time, and recursive least squares."""
