//! How much memory may be used, and how much was.

use sysinfo::{MemoryRefreshKind, RefreshKind, System};

/// Share of the machine's memory that `--max-memory` allows unless told otherwise: the rest
/// is for the system, the image and the estimate's error.
const DEFAULT_PERCENT: u64 = 80;

/// Reads `8G`, `512M`, `64K` or plain bytes; units are powers of 1024, `iB` and `B` optional.
pub(super) fn parse_size(s: &str) -> Result<u64, String> {
    let digits = s.trim_end_matches(|c: char| !c.is_ascii_digit());
    let unit = match s[digits.len()..].to_ascii_lowercase().as_str() {
        "" | "b" => Some(1),
        "k" | "kb" | "kib" => Some(1 << 10),
        "m" | "mb" | "mib" => Some(1 << 20),
        "g" | "gb" | "gib" => Some(1 << 30),
        "t" | "tb" | "tib" => Some(1 << 40),
        _ => None,
    };
    let count = digits.parse::<u64>().ok();
    count
        .zip(unit)
        .and_then(|(count, unit)| count.checked_mul(unit))
        .ok_or_else(|| "expected a number of bytes, or one with K, M, G or T".to_owned())
}

/// Returns what may be used: as asked, else a share of what the machine or the process's
/// control group has.
pub(super) fn limit(asked: Option<u64>) -> u64 {
    asked.unwrap_or_else(|| {
        let what = RefreshKind::nothing().with_memory(MemoryRefreshKind::nothing().with_ram());
        // A system that does not say how much memory it has is not limited.
        let Ok(system) = System::new_with_specifics(what) else {
            return u64::MAX;
        };
        let machine = system.total_memory();
        let group = system.cgroup_limits().map_or(machine, |g| g.total_memory);
        machine.min(group) / 100 * DEFAULT_PERCENT
    })
}

/// Returns the largest resident memory of this process so far, where the system tells.
pub(super) fn peak_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    let kib = line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?;
    kib.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes() {
        assert_eq!(parse_size("8G"), Ok(8 << 30));
        assert_eq!(parse_size("512MiB"), Ok(512 << 20));
        assert_eq!(parse_size("1000"), Ok(1000));
        for bad in ["", "G", "1.5G", "-1", "8X", "99999999999T", "8Gé"] {
            assert!(parse_size(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn the_default_is_below_what_the_machine_has() {
        let limit = limit(None);
        assert!(limit > 1 << 20, "{limit}");
    }
}
