//! Rays of a scene, walked four times over, each time with more of the work.
//!
//! | pass | work |
//! |---|---|
//! | start | each ray is placed in the grid, by a turn where a path has come to |
//! | walk | and steps through segments |
//! | read | and reads values on the way |
//! | track | and all that the scene's estimators do |
//!
//! What a pass takes longer than the one before is what its work takes. The rays are of plain paths: flights
//! in directions of the phase function, and as many shadow rays towards suns as the integrator casts, but
//! without its choices among directions. Their steps and reads are those of delta and ratio tracking.

use std::hint::black_box;
use std::ops::{ControlFlow, Range};

use glam::DVec3;
use majorant::grid::Bound;
use majorant::grid::tree::Slot;
use majorant::integrator::{absorbing_tracking, absorbs_only};
use majorant::medium::{BoundSegment, Medium, MediumRay};
use majorant::sampling::{Stream, StreamKey};
use majorant::scene::Scene;
use majorant::space::{Ray, floor_to_voxel};
use majorant::stats::Counts;
use majorant::tracking::collision::{Collision, Visitor, walk};
use majorant::tracking::distance::EXACT_COLLISIONS_PER_VOXEL;
use majorant::tracking::{DistanceEstimator, Survey, Tracking, TransmittanceEstimator};

use super::reuse::Follower;

/// Weights and transmittances below this play roulette, about as in the integrator.
const ROULETTE: f32 = 0.05;

/// What is timed, from the least work to the most.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pass {
    Start,
    Walk,
    Read,
    Track,
}

impl Pass {
    pub(super) const ALL: [Self; 4] = [Self::Start, Self::Walk, Self::Read, Self::Track];
}

/// A medium, and what tracks it.
#[derive(Debug)]
pub(super) struct Tracked<'a> {
    medium: &'a Medium,
    tracking: Tracking,
}

impl Tracked<'_> {
    /// Returns bytes of a value read, and of the cell that a step reads.
    pub(super) fn bytes_per_event(&self) -> [usize; 2] {
        let value = self.medium.grid().values().encoding().value_bytes();
        [value, size_of::<Bound>() + size_of::<Slot>()]
    }
}

/// Returns the media of a scene with the estimators that rendering takes.
pub(super) fn tracked(scene: &Scene) -> Vec<Tracked<'_>> {
    let settings = scene.transport;
    let absorbs = absorbs_only(&settings, &scene.media);
    let of = |medium| {
        let tracking = if absorbs {
            absorbing_tracking(settings.tracking)
        } else {
            settings.tracking.fitted(&Survey::new(medium))
        };
        Tracked { medium, tracking }
    };
    scene.media.iter().map(of).collect()
}

/// Where a path has met a medium.
#[derive(Debug)]
struct Vertex<'a> {
    medium: usize,
    walk: MediumRay<'a>,
    t: f64,
}

/// Where a ray starts.
#[derive(Clone, Copy, Debug)]
enum Start {
    Outside(Ray),
    Vertex(usize, DVec3),
}

/// A ray in one medium.
#[derive(Debug)]
struct Walk {
    medium: usize,
    start: Start,
    t_max: f64,
    is_shadow: bool,
    /// Steps, with the last one if it led to the end.
    steps: u32,
    reads: Range<usize>,
}

/// A place where values are read.
#[derive(Debug)]
struct Read {
    /// After which step of its walk.
    step: u32,
    t: f64,
    bits: u64,
    /// Whether all voxel cells of the segment are integrated.
    is_integral: bool,
}

/// The rays of some paths.
#[derive(Debug)]
pub(super) struct Replay<'a> {
    scene: &'a Scene,
    tracked: &'a [Tracked<'a>],
    /// Shadow rays for each vertex.
    shadows: f32,
    stream: Stream,
    vertices: Vec<Vertex<'a>>,
    walks: Vec<Walk>,
    reads: Vec<Read>,
}

impl<'a> Replay<'a> {
    /// Begins without rays.
    pub(super) fn new(
        scene: &'a Scene,
        tracked: &'a [Tracked<'a>],
        shadows: f32,
        key: StreamKey,
    ) -> Self {
        Self {
            scene,
            tracked,
            shadows,
            stream: Stream::new(key),
            vertices: Vec::new(),
            walks: Vec::new(),
            reads: Vec::new(),
        }
    }

    /// Returns the number of rays, each in one medium.
    pub(super) fn ray_count(&self) -> usize {
        self.walks.len()
    }

    /// Returns what the rays did while they were recorded.
    pub(super) fn recorded(&self) -> &Counts {
        &self.stream.counts
    }

    /// Sends a path out along a camera ray, and keeps its rays.
    pub(super) fn add_path(&mut self, camera_ray: Ray, follower: &mut Follower) {
        let start = Start::Outside(camera_ray);
        if absorbs_only(&self.scene.transport, &self.scene.media) {
            for medium in 0..self.tracked.len() {
                self.record(medium, start, f64::INFINITY, true, follower);
            }
            return;
        }
        let Some(mut vertex) = self.flight(None, start, follower) else {
            return;
        };
        let mut direction = camera_ray.direction;
        let mut weight = 1.0;
        let mut bounces = 0;
        loop {
            let Vertex { medium, walk, t } = &self.vertices[vertex];
            let (medium, phase) = (*medium, walk.medium().phase());
            weight *= walk.albedo(*t).max_channel();
            bounces += 1;
            if weight < ROULETTE {
                if self.stream.uniform() * ROULETTE >= weight {
                    return;
                }
                weight = ROULETTE;
            }
            let mut casts = self.shadows + self.stream.uniform();
            while casts >= 1.0 {
                casts -= 1.0;
                let towards = self.towards_light().unwrap_or_else(|| {
                    // Of skies and lamps, any will do.
                    phase.sample(direction, &mut self.stream)
                });
                let start = Start::Vertex(vertex, towards);
                for i in 0..self.tracked.len() {
                    let start = if i == medium {
                        start
                    } else {
                        self.outside(start)
                    };
                    self.record(i, start, f64::INFINITY, true, follower);
                }
            }
            if self.scene.transport.max_bounces == Some(bounces) {
                return;
            }
            direction = phase.sample(direction, &mut self.stream);
            let start = Start::Vertex(vertex, direction);
            let Some(next) = self.flight(Some(medium), start, follower) else {
                return;
            };
            vertex = next;
        }
    }

    /// Returns a direction to a sun; `None` without any.
    fn towards_light(&mut self) -> Option<DVec3> {
        let suns = &self.scene.lights.distant;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "an index, below the number of suns"
        )]
        let i = (self.stream.uniform() * suns.len() as f32) as usize;
        Some(suns.get(i)?.sample(&mut self.stream).direction)
    }

    /// Flies to the next collision with any medium, of which that of the start comes first; returns
    /// its vertex.
    fn flight(
        &mut self,
        first: Option<usize>,
        start: Start,
        follower: &mut Follower,
    ) -> Option<usize> {
        let others = (0..self.tracked.len()).filter(|&i| Some(i) != first);
        let order: Vec<_> = first.into_iter().chain(others).collect();
        let mut t_max = f64::INFINITY;
        let mut nearest = None;
        for medium in order {
            let start = if Some(medium) == first {
                start
            } else {
                self.outside(start)
            };
            if let Some((walk, t)) = self.record(medium, start, t_max, false, follower) {
                t_max = t;
                nearest = Some(Vertex { medium, walk, t });
            }
        }
        self.vertices.push(nearest?);
        Some(self.vertices.len() - 1)
    }

    /// Returns a start as that of a ray that no medium knows yet.
    fn outside(&self, start: Start) -> Start {
        match start {
            Start::Outside(_) => start,
            Start::Vertex(vertex, direction) => {
                let Vertex { walk, t, .. } = &self.vertices[vertex];
                let origin = walk.world_position(*t);
                Start::Outside(Ray { origin, direction })
            }
        }
    }

    /// Tracks and keeps a ray; returns where a flight has met the medium.
    fn record(
        &mut self,
        medium: usize,
        start: Start,
        t_max: f64,
        is_shadow: bool,
        follower: &mut Follower,
    ) -> Option<(MediumRay<'a>, f64)> {
        let first = self.reads.len();
        let mut kept = Walk {
            medium,
            start,
            t_max,
            is_shadow,
            steps: 0,
            reads: first..first,
        };
        let mut ray = self.start(&kept);
        let Tracked {
            medium: of,
            tracking,
        } = &self.tracked[medium];
        let is_exact = if is_shadow {
            tracking.transmittance == TransmittanceEstimator::Exact
        } else {
            tracking.distance == DistanceEstimator::Regular
        };
        let mut recorder = Recorder {
            medium,
            value_bytes: of.grid().values().encoding().value_bytes(),
            exact_above: if is_exact {
                0.0
            } else {
                EXACT_COLLISIONS_PER_VOXEL * ray.voxels_per_length()
            },
            weight: is_shadow.then_some(1.0),
            met: None,
            is_over: true,
            step: 0,
            reads: &mut self.reads,
            follower,
        };
        walk(&mut ray, &mut self.stream, &mut recorder);
        let met = recorder.met;
        kept.steps = recorder.step + u32::from(recorder.is_over);
        kept.reads.end = self.reads.len();
        self.walks.push(kept);
        met.map(|t| (ray, t))
    }

    /// Places a ray in the grid.
    fn start(&self, walk: &Walk) -> MediumRay<'a> {
        let Tracked { medium, tracking } = &self.tracked[walk.medium];
        match walk.start {
            Start::Vertex(vertex, direction) => {
                let Vertex { walk: path, t, .. } = &self.vertices[vertex];
                let mut ray = path.clone();
                ray.turn(*t, direction, walk.t_max);
                ray
            }
            Start::Outside(ray) => tracking.start_path(medium, &ray, walk.t_max),
        }
    }

    /// Does one of the passes over all rays; returns what that of the estimators counts.
    pub(super) fn run(&self, pass: Pass) -> Counts {
        let mut counts = Counts::default();
        match pass {
            Pass::Start => {
                for walk in &self.walks {
                    black_box(self.start(walk));
                }
            }
            Pass::Walk => {
                for walk in &self.walks {
                    let mut ray = self.start(walk);
                    for _ in 0..walk.steps {
                        black_box(ray.next_segment());
                    }
                }
            }
            Pass::Read => {
                for walk in &self.walks {
                    self.read(walk, &mut counts);
                }
            }
            Pass::Track => {
                let mut stream = Stream::new(StreamKey::default());
                for walk in &self.walks {
                    self.track(walk, &mut stream);
                }
                counts = stream.counts;
            }
        }
        counts
    }

    fn read(&self, walk: &Walk, counts: &mut Counts) {
        let mut ray = self.start(walk);
        let mut reads = self.reads[walk.reads.clone()].iter().peekable();
        for step in 1..=walk.steps {
            black_box(ray.next_segment());
            while let Some(read) = reads.next_if(|read| read.step == step) {
                if read.is_integral {
                    black_box(ray.optical_depth(counts));
                } else {
                    black_box(ray.estimate_sigma_t(read.t, read.bits));
                }
            }
        }
    }

    fn track(&self, walk: &Walk, stream: &mut Stream) {
        let Tracked { medium, tracking } = &self.tracked[walk.medium];
        match walk.start {
            _ if !walk.is_shadow => {
                let mut ray = self.start(walk);
                let depth = stream.exponential();
                black_box(tracking.next_collision(&mut ray, depth, stream));
            }
            Start::Vertex(vertex, direction) => {
                let Vertex { walk: path, t, .. } = &self.vertices[vertex];
                let to = (direction, walk.t_max);
                black_box(tracking.transmittance_from((path, *t), to, ROULETTE, stream));
            }
            Start::Outside(ray) => {
                let t_max = walk.t_max;
                black_box(tracking.estimate_transmittance(medium, &ray, t_max, ROULETTE, stream));
            }
        }
    }
}

/// Tracks a ray by the textbook, and keeps what it does.
struct Recorder<'r> {
    medium: usize,
    value_bytes: usize,
    /// The rate above which segments are integrated.
    exact_above: f64,
    /// Of a shadow ray.
    weight: Option<f32>,
    met: Option<f64>,
    /// Whether the walk has not been ended.
    is_over: bool,
    step: u32,
    reads: &'r mut Vec<Read>,
    follower: &'r mut Follower,
}

impl Recorder<'_> {
    fn end(&mut self, met: Option<f64>) {
        self.met = met;
        self.is_over = false;
    }

    /// Multiplies the weight of a shadow ray, and plays roulette.
    fn take(&mut self, factor: f32, stream: &mut Stream) -> ControlFlow<()> {
        if let Some(weight) = &mut self.weight {
            *weight *= factor;
            if *weight < ROULETTE {
                if stream.uniform() * ROULETTE >= *weight {
                    self.end(None);
                    return ControlFlow::Break(());
                }
                *weight = ROULETTE;
            }
        }
        ControlFlow::Continue(())
    }
}

impl Visitor for Recorder<'_> {
    fn enter(
        &mut self,
        ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        depth: &mut f32,
        stream: &mut Stream,
    ) -> ControlFlow<(), f32> {
        self.step += 1;
        let (t0, length) = (segment.t0, segment.t1 - segment.t0);
        self.follower
            .step(self.medium, ray.index_position(t0 + 0.5 * length));
        #[expect(clippy::cast_possible_truncation, reason = "a number in [0, 1]")]
        let through = |depth: f64| (-depth).exp() as f32;
        if segment.is_homogeneous() && self.weight.is_some() {
            self.take(through(f64::from(segment.sigma_maj) * length), stream)?;
            return ControlFlow::Continue(0.0);
        }
        if segment.is_homogeneous() || f64::from(segment.sigma_maj) <= self.exact_above {
            return ControlFlow::Continue(segment.sigma_maj);
        }
        self.reads.push(Read {
            step: self.step,
            t: t0,
            bits: 0,
            is_integral: true,
        });
        if self.weight.is_some() {
            self.take(through(ray.optical_depth(&mut stream.counts)), stream)?;
            return ControlFlow::Continue(0.0);
        }
        let mut left = f64::from(*depth);
        if let Some(t) = ray.reach_depth(&mut left, &mut stream.counts) {
            self.end(Some(t));
            return ControlFlow::Break(());
        }
        #[expect(clippy::cast_possible_truncation, reason = "as precise as it came")]
        {
            *depth = left as f32;
        }
        ControlFlow::Continue(0.0)
    }

    fn collide(
        &mut self,
        ray: &mut MediumRay<'_>,
        segment: &BoundSegment,
        collision: &Collision,
        stream: &mut Stream,
    ) -> ControlFlow<()> {
        let Collision { t, rate } = *collision;
        if segment.is_homogeneous() {
            self.end(Some(t));
            return ControlFlow::Break(());
        }
        stream.counts.lookups += 1;
        let bits = stream.bits();
        self.reads.push(Read {
            step: self.step,
            t,
            bits,
            is_integral: false,
        });
        // The voxel that these bits choose, but for the last of their digits.
        let u = |shift: u32| (bits >> shift & 0x1f_ffff) as f64 * (1.0 / 2_097_152.0);
        let p = ray.index_position(t) + DVec3::new(u(0), u(21), u(42));
        self.follower
            .read(self.medium, floor_to_voxel(p), self.value_bytes);
        let share = ray.estimate_sigma_t(t, bits) / rate;
        if self.weight.is_some() {
            return self.take(1.0 - share, stream);
        }
        if stream.uniform() < share {
            self.end(Some(t));
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(())
    }
}
