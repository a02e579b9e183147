//! What shines and what colours it: lamps, skies, fires, several media, channels apart.

mod agreement;
mod aovs;
mod chromatic;
mod coloured;
mod emission;
mod emission_agreement;
mod emission_oracles;
mod lights;
mod skies;
mod superposition;

#[path = "../support/mod.rs"]
mod support;
