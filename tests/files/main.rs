//! What comes from files and goes into them: volumes, caches, scenes; good ones, damaged ones, hostile
//! ones.

mod cache;
mod hostile;
mod scene_errors;
mod scene_format;
mod storage;
mod vdb_matrix;
mod vdb_mutants;
mod vdb_policy;
mod vdb_regressions;
mod vdb_support;
