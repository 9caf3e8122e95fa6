//! Body models, fitting and the stages: the library.
