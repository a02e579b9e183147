//! The stiffness certificate.
use super::Check;
pub(super) fn checks(_out: &mut Vec<Check>) {}
