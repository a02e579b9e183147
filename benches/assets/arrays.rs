//! What lookups are measured against: the same values in a dense array and in flat bricks.
//!
//! None of it is in the library. A dense array is the floor of what a lookup can cost; flat
//! bricks show what an apron and an encoding change, all else equal: a dense table of brick
//! indices in place of a tree, values of 1, 2 or 4 bytes, and 8³ or, with an apron, 9³ of them,
//! so that all eight taps of a point are in the brick of its floor.

use glam::{DVec3, IVec3};
use half::f16;
use majorant::grid::Tree;
use majorant::grid::brick::{BRICK_DIM, BRICK_LOG2, voxel_at};
use majorant::space::{Aabb, floor_to_voxel};

/// A dense copy of a box and one layer above it, `[x][y][z]`, z fastest.
pub(crate) struct Dense {
    pub(crate) low: IVec3,
    pub(crate) dim: IVec3,
    values: Vec<f32>,
}

impl Dense {
    /// Copies the bricks of `tree` into an array that covers `bounds` and all its taps.
    pub(crate) fn new(tree: &Tree<f32>, bounds: Aabb) -> Self {
        let low = floor_to_voxel(bounds.min);
        let dim = floor_to_voxel(bounds.max) - low + IVec3::ONE;
        let len = usize::try_from(dim.as_u64vec3().element_product()).expect("it fits");
        let mut dense = Self {
            low,
            dim,
            values: vec![tree.background(); len],
        };
        assert!(
            !tree.stored_tiles().any(|(_, _, tile)| tile.value > 0.0),
            "only bricks are copied"
        );
        for (brick, &origin) in tree.brick_origins().iter().enumerate() {
            for (offset, &value) in tree.brick(brick).iter().enumerate() {
                let p = origin + voxel_at(offset);
                if (p - low).cmpge(IVec3::ZERO).all() && (p - low).cmplt(dim).all() {
                    let index = dense.index(p);
                    dense.values[index] = value;
                }
            }
        }
        dense
    }

    fn index(&self, p: IVec3) -> usize {
        let q = (p - self.low).as_u64vec3();
        let dim = self.dim.as_u64vec3();
        usize::try_from((q.x * dim.y + q.y) * dim.z + q.z).expect("inside the array")
    }

    pub(crate) fn value(&self, p: IVec3) -> f32 {
        self.values[self.index(p)]
    }

    pub(crate) fn trilinear(&self, p_index: DVec3) -> f32 {
        let lo = floor_to_voxel(p_index);
        let base = self.index(lo);
        let dx = self.index(lo + IVec3::X) - base;
        let dy = self.index(lo + IVec3::Y) - base;
        interpolate(p_index - lo.as_dvec3(), |x, y, z| {
            self.values[base + x * dx + y * dy + z]
        })
    }

    pub(crate) fn stochastic(&self, p_index: DVec3, bits: u64) -> f32 {
        self.value(drawn_voxel(p_index, bits))
    }

    /// Returns the largest value that a filter reads at points from `from` to just below `to`.
    pub(crate) fn max_in(&self, from: DVec3, to: DVec3) -> f32 {
        let first = (floor_to_voxel(from) - self.low).max(IVec3::ZERO);
        let last = (floor_to_voxel(to.ceil()) - self.low).min(self.dim - 1);
        let mut max = 0.0_f32;
        for x in first.x..=last.x {
            for y in first.y..=last.y {
                for z in first.z..=last.z {
                    max = max.max(self.value(self.low + IVec3::new(x, y, z)));
                }
            }
        }
        max
    }
}

/// Interpolates between the corners that `at` returns.
fn interpolate(f: DVec3, at: impl Fn(usize, usize, usize) -> f32) -> f32 {
    let f = f.as_vec3();
    let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let along_z = |x, y| lerp(at(x, y, 0), at(x, y, 1), f.z);
    let along_yz = |x| lerp(along_z(x, 0), along_z(x, 1), f.y);
    lerp(along_yz(0), along_yz(1), f.x)
}

/// Returns the voxel that the library's one-tap lookup draws with the same bits.
fn drawn_voxel(p_index: DVec3, bits: u64) -> IVec3 {
    let u = |shift: u32| (bits >> shift & 0x1f_ffff) as f64 * (1.0 / 2_097_152.0);
    floor_to_voxel(p_index + DVec3::new(u(0), u(21), u(42)))
}

/// How a value is stored, given the lowest value of its brick and the step between codes.
pub(crate) trait Code: Copy {
    /// Steps between the lowest and the highest code; 0 where floats are stored as they are.
    const STEPS: f32;
    fn encode(value: f32, low: f32, step: f32) -> Self;
    fn decode(self, low: f32, step: f32) -> f32;
}

impl Code for f32 {
    const STEPS: Self = 0.0;
    fn encode(value: Self, _low: Self, _step: Self) -> Self {
        value
    }
    fn decode(self, _low: Self, _step: Self) -> Self {
        self
    }
}

impl Code for f16 {
    const STEPS: f32 = 0.0;
    fn encode(value: f32, _low: f32, _step: f32) -> Self {
        Self::from_f32(value)
    }
    fn decode(self, _low: f32, _step: f32) -> f32 {
        self.to_f32()
    }
}

macro_rules! linear_code {
    ($($t:ty)*) => {$(
        impl Code for $t {
            const STEPS: f32 = <$t>::MAX as f32;
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "rounded, and in range by the choice of the step"
            )]
            fn encode(value: f32, low: f32, step: f32) -> Self {
                if step > 0.0 { ((value - low) / step).round() as Self } else { 0 }
            }
            fn decode(self, low: f32, step: f32) -> f32 {
                low + step * f32::from(self)
            }
        }
    )*};
}
linear_code!(u16 u8);

/// Bricks of `SIDE`³ values, 8 or, with an apron, 9, found through a dense table.
pub(crate) struct Bricks<C, const SIDE: usize> {
    /// In bricks.
    low: IVec3,
    dim: IVec3,
    /// Index of the brick of each cell; 0 is a brick of zeros.
    table: Vec<u32>,
    /// Lowest value and step of each brick.
    ranges: Vec<[f32; 2]>,
    codes: Vec<C>,
}

impl<C: Code, const SIDE: usize> Bricks<C, SIDE> {
    const LEN: usize = SIDE * SIDE * SIDE;

    /// Copies `dense`, which starts at a multiple of 8.
    pub(crate) fn new(dense: &Dense) -> Self {
        let low = dense.low >> BRICK_LOG2;
        let dim = (dense.dim + (BRICK_DIM - 1)) >> BRICK_LOG2;
        let mut bricks = Self {
            low,
            dim,
            table: Vec::new(),
            ranges: vec![[0.0; 2]],
            codes: vec![C::encode(0.0, 0.0, 0.0); Self::LEN],
        };
        let side = i32::try_from(SIDE).expect("8 or 9");
        let mut values = Vec::with_capacity(Self::LEN);
        for cell in (0..dim.x).flat_map(|x| {
            (0..dim.y).flat_map(move |y| (0..dim.z).map(move |z| IVec3::new(x, y, z)))
        }) {
            let origin = (low + cell) << BRICK_LOG2;
            values.clear();
            for i in 0..side * side * side {
                let p = origin + IVec3::new(i / (side * side), i / side % side, i % side);
                let is_inside = (p - dense.low).cmplt(dense.dim).all();
                values.push(if is_inside { dense.value(p) } else { 0.0 });
            }
            let min = values.iter().copied().fold(f32::INFINITY, f32::min);
            let max = values.iter().copied().fold(0.0, f32::max);
            if max == 0.0 {
                bricks.table.push(0);
                continue;
            }
            let step = if C::STEPS > 0.0 {
                (max - min) / C::STEPS
            } else {
                0.0
            };
            let index = u32::try_from(bricks.ranges.len()).expect("few bricks");
            bricks.table.push(index);
            bricks.ranges.push([min, step]);
            let codes = values.iter().map(|&v| C::encode(v, min, step));
            bricks.codes.extend(codes);
        }
        bricks
    }

    fn brick(&self, p: IVec3) -> usize {
        let q = ((p >> BRICK_LOG2) - self.low).as_uvec3();
        let dim = self.dim.as_uvec3();
        self.table[((q.x * dim.y + q.y) * dim.z + q.z) as usize] as usize
    }

    fn offset(p: IVec3) -> usize {
        let q = (p & (BRICK_DIM - 1)).as_uvec3();
        (q.x as usize * SIDE + q.y as usize) * SIDE + q.z as usize
    }

    fn decode(&self, brick: usize, offset: usize) -> f32 {
        let [low, step] = self.ranges[brick];
        self.codes[brick * Self::LEN + offset].decode(low, step)
    }

    pub(crate) fn value(&self, p: IVec3) -> f32 {
        self.decode(self.brick(p), Self::offset(p))
    }

    pub(crate) fn stochastic(&self, p_index: DVec3, bits: u64) -> f32 {
        self.value(drawn_voxel(p_index, bits))
    }

    pub(crate) fn trilinear(&self, p_index: DVec3) -> f32 {
        let lo = floor_to_voxel(p_index);
        let f = p_index - lo.as_dvec3();
        let is_inside = (lo & (BRICK_DIM - 1)).max_element() < BRICK_DIM - 1;
        if SIDE > 8 || is_inside {
            let (brick, offset) = (self.brick(lo), Self::offset(lo));
            interpolate(f, |x, y, z| {
                self.decode(brick, offset + (x * SIDE + y) * SIDE + z)
            })
        } else {
            let corner = |i: usize| i32::from(i == 1);
            interpolate(f, |x, y, z| {
                self.value(lo + IVec3::new(corner(x), corner(y), corner(z)))
            })
        }
    }
}
