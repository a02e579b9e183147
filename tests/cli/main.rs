//! The program as its users run it.

mod converge;
mod data_scenes;
mod farm;
mod info;
mod progress;
mod render;
mod sequence;
mod support;
mod verify;
