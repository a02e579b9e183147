//! Whether this processor has the instructions that the program was built for.

use std::process::ExitCode;

/// Says what is missing, and what to do, where a build for newer processors would die of an illegal
/// instruction; returns the exit code then.
///
/// Asks the processor itself: the standard library takes a feature that a build relies on for granted.
#[cfg(all(target_arch = "x86_64", target_feature = "avx2"))]
#[inline(never)]
pub(crate) fn refuse_older() -> Option<ExitCode> {
    use std::io::Write as _;

    let cpu = raw_cpuid::CpuId::new();
    let (basic, extended) = (cpu.get_feature_info(), cpu.get_extended_feature_info());
    let has_fma = basic.is_some_and(|f| f.has_fma() && f.has_avx() && f.has_oxsave());
    if has_fma && extended.is_some_and(|f| f.has_avx2() && f.has_bmi1() && f.has_bmi2()) {
        return None;
    }
    let _ = writeln!(
        std::io::stderr().lock(),
        "majorant: this processor, or the virtual machine around it, has no AVX2, BMI or FMA \
         (processors since 2013 do), for which this program was built. Build it for older ones: \
         RUSTFLAGS=\"-C target-cpu=x86-64\" cargo build --release"
    );
    Some(ExitCode::FAILURE)
}

/// A build for any processor runs on any.
#[cfg(not(all(target_arch = "x86_64", target_feature = "avx2")))]
pub(crate) fn refuse_older() -> Option<ExitCode> {
    None
}
