//! Box-constrained least squares and quasi-Newton over residual blocks; knows no mesh.
