//! Criterion by CPU time instead of wall time: what other programs take is not counted.
//!
//! For work on one thread. What a neighbour does to caches and clock rates still shows.

use std::time::Duration;

use cpu_time::ProcessTime;
use criterion::Criterion;
use criterion::measurement::{Measurement, ValueFormatter, WallTime};

/// CPU time of this process.
#[derive(Debug, Default)]
pub(crate) struct CpuClock;

impl Measurement for CpuClock {
    type Intermediate = ProcessTime;
    type Value = Duration;

    fn start(&self) -> ProcessTime {
        ProcessTime::now()
    }

    fn end(&self, start: ProcessTime) -> Duration {
        start.elapsed()
    }

    fn add(&self, a: &Duration, b: &Duration) -> Duration {
        *a + *b
    }

    fn zero(&self) -> Duration {
        Duration::ZERO
    }

    fn to_f64(&self, value: &Duration) -> f64 {
        value.as_secs_f64() * 1e9
    }

    fn formatter(&self) -> &dyn ValueFormatter {
        // The same unit: nanoseconds.
        WallTime.formatter()
    }
}

/// Criterion with the arguments of the command line, by this clock.
pub(crate) fn criterion() -> Criterion<CpuClock> {
    Criterion::default().with_measurement(CpuClock)
}
