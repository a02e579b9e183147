//! majorant renders OpenVDB clouds, smoke and fire on the CPU, without bias.
//!
//! Three words make up most of the program:
//!
//! * A **majorant** is an upper bound of the extinction along a stretch of a ray. The grid keeps
//!   one for every brick of 8³ voxels and for every larger cell, so bounds are local and tight.
//! * **Delta tracking** draws the distance to the next collision by colliding at the majorant's
//!   rate and rejecting what hits nothing. It is exact for any bound that is never too low.
//! * **Ratio tracking** estimates the light that gets through by multiplying the probabilities
//!   of those rejections.
//!
//! # From file to picture
//!
//! ```
//! use std::path::Path;
//! use std::sync::Arc;
//! use std::sync::atomic::AtomicBool;
//!
//! use majorant::camera::Camera;
//! use majorant::grid::DensityGrid;
//! use majorant::light::Lights;
//! use majorant::medium::Medium;
//! use majorant::phase::Phase;
//! use majorant::render::{NoProgress, render};
//! use majorant::scene::Scene;
//! use majorant::spectrum::Rgb;
//! use majorant::vdb::{Archive, LoadOptions};
//! use glam::DVec3;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! // A file is walked and checked first; nothing is decoded yet.
//! let archive = Archive::open(Path::new("data/tower.vdb"))?;
//! let data = archive.load_density(archive.find("density")?, &LoadOptions::default())?;
//!
//! // Bricks and bounds; then optics: extinction per unit of density, albedo, phase function.
//! let grid = Arc::new(DensityGrid::new(data.tree, data.transform, 1 << 30)?);
//! let medium = Medium::new(grid, 20.0, Rgb::splat(0.9), Phase::HenyeyGreenstein { g: 0.6 });
//!
//! let eye = DVec3::new(1.0, -7.0, 1.5);
//! let camera = Camera::look_at(eye, DVec3::new(1.0, 1.0, 1.5), DVec3::Z, 0.6, 1.0)
//!     .ok_or("that camera sees nothing")?;
//! let scene = Scene {
//!     width: 32,
//!     height: 32,
//!     spp: 4,
//!     seed: 0,
//!     frame: 0,
//!     aovs: vec![],
//!     camera,
//!     media: vec![medium],
//!     lights: Lights { environment: Rgb::WHITE, ..Lights::default() },
//!     transport: Default::default(),
//! };
//! let rendered = render(&scene, &NoProgress, &AtomicBool::new(false));
//! assert_eq!(rendered.counts.bound_violations, 0);
//!
//! // Looking up from below the sky is white; the smoke takes some of it away.
//! let (mean, _standard_error) = rendered.film.mean();
//! assert!(mean[0] < 1.0);
//! # Ok(())
//! # }
//! ```
//!
//! # Spaces and units
//!
//! *World* is the scene's space; distances along a ray are world distances everywhere, and
//! coefficients are per world unit. *Index* space belongs to one grid: voxel values sit at
//! integer points. Names say which: `p_world`, `ray_index`. See [`space`].
//!
//! # Layers
//!
//! | layer | modules |
//! |---|---|
//! | foundations | [`space`], [`spectrum`], [`sampling`], [`stats`] |
//! | storage | [`grid`], filled by [`vdb`] or [`cache`] |
//! | optics | [`phase`], [`light`], [`camera`], [`emission`], [`medium`] |
//! | estimators | [`tracking`], [`integrator`] |
//! | frames | [`sequence`], [`scene`], [`plan`], [`render`], [`film`], [`output`] |
//!
//! Nothing low knows anything high; a test holds the table in `docs/architecture.md` against the
//! source.

pub mod alias;
pub mod aov;
pub mod blackbody;
pub mod cache;
pub mod camera;
pub mod converge;
pub mod emission;
pub mod farm;
pub mod field;
pub mod film;
pub mod grid;
pub mod integrator;
pub mod light;
pub mod medium;
pub mod noise_limit;
pub mod output;
pub mod phase;
pub mod plan;
pub mod plot;
pub mod render;
pub mod sampling;
pub mod scene;
pub mod sequence;
pub mod silhouette;
pub mod sobol;
pub mod space;
pub mod spectrum;
pub mod stats;
pub mod tracking;
pub mod vdb;
pub mod verify;
