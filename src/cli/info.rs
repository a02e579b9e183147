//! stub
use super::Failure;
pub(super) fn run(_: &super::args::InfoArgs) -> Result<(), Failure> { Ok(()) }
