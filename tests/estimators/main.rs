//! Estimators of flights, transmittances and radiances against oracles and each other, and what they
//! rest on.

mod converge;
mod estimator_variance;
mod free_flight;
mod grid_properties;
mod levers;
mod phase_functions;
mod primary;
mod transport;
mod verify;

#[path = "../support/mod.rs"]
mod support;
