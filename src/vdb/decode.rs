//! Shares of a grid, decoded in parallel straight into the final arrays.
//!
//! Each share is a small canonical stream of at most 4096 leaves. One thread builds it, lets
//! vdb-rs decode it, copies the values to their place and drops it, so at any time only a few
//! megabytes a thread exist besides the result. Where a share begins never changes what is
//! decoded: results are the same for any number of threads.
//!
//! Not done here: what the values mean. [`Ingest`] decides what is kept of them.

use std::io::Cursor as IoCursor;
use std::panic::{AssertUnwindSafe, catch_unwind};

use bytemuck::{Pod, pod_read_unaligned};
use glam::IVec3;
use half::f16;
use rayon::prelude::*;
use vdb_rs::{Grid, ParseError, VdbReader};

use super::canonical::{self, GRID_NAME, MAX_LEAVES, MAX_LOWERS};
use super::cursor::Cursor;
use super::error::Damage;
use super::record::{Encoding, Inactive, Record, words};
use super::topology::{
    LOWER_MASK, Node, NodeAt, Topology, UPPER_MASK, ones, read_leaf, slot_origin,
};
use crate::grid::Voxel;
use crate::grid::brick::{BRICK_LEN, BRICK_LOG2, BrickMask};
use crate::grid::tree::{LOWER_LOG2, LOWER_TOTAL_LOG2, Tree, TreeBuilder, UPPER_LOG2};

/// Decoded bytes of a share: small enough to stay in cache, large enough that its made-up
/// nodes (32768 values that vdb-rs expands) are a few per cent of the work.
const SHARE_BYTES: usize = 2 << 20;
/// Nodes whose tile values are decoded before they go into the tree: bounds what is in flight.
const NODES_IN_FLIGHT: usize = 256;
const UPPERS_A_SHARE: usize = 1;
const LOWERS_A_SHARE: usize = 16;

/// A value as files store it.
pub(super) trait Stored: Voxel {
    /// What vdb-rs is asked for where the grid is saved as half.
    type Half: Pod + Send;
    fn from_half(half: Self::Half) -> Self;
    /// The inactive value that a level set has inside.
    fn negative(self) -> Self;
}

macro_rules! stored {
    ($($t:ty, $half:ty, $from_half:expr, $negative:expr;)*) => {$(
        impl Stored for $t {
            type Half = $half;
            fn from_half(half: $half) -> Self {
                $from_half(half)
            }
            fn negative(self) -> Self {
                $negative(self)
            }
        }
    )*};
}
// vdb-rs widens half floats only when asked for f32, so f64 goes by way of f32, exactly.
// Integers are never halved.
stored! {
    f32, f32, |h| h, |v: Self| -v;
    f64, f32, f64::from, |v: Self| -v;
    i32, i32, |h| h, Self::wrapping_neg;
    i64, i64, |h| h, Self::wrapping_neg;
    [f32; 3], [f16; 3], |h: [f16; 3]| h.map(f32::from), |v: Self| v.map(|x| -x);
    [f64; 3], [f16; 3], |h: [f16; 3]| h.map(f64::from), |v: Self| v.map(|x| -x);
    [i32; 3], [i32; 3], |h| h, |v: Self| v.map(i32::wrapping_neg);
}

/// What becomes of decoded values.
pub(super) trait Ingest<V>: Sync {
    /// The values of the resulting tree.
    type Out: Voxel;
    /// What is counted on the way.
    type Tally: Default + Send;
    fn convert(&self, value: V) -> Self::Out;
    /// Sees all values that will be stored: whole bricks, and single values for tiles and the
    /// background (`None`).
    fn inspect(&self, origin: Option<IVec3>, values: &mut [Self::Out], tally: &mut Self::Tally);
    /// Merges counts; `later` comes later in file order.
    fn merge(&self, into: &mut Self::Tally, later: Self::Tally);
}

/// Why decoding stopped.
#[derive(Debug)]
pub(super) enum DecodeError {
    Damage(Damage),
    Undecodable(String),
    OutOfMemory { bytes: u64 },
}

impl From<Damage> for DecodeError {
    fn from(damage: Damage) -> Self {
        Self::Damage(damage)
    }
}

/// A grid being decoded.
pub(super) struct Decoder<'a, I> {
    pub(super) bytes: &'a [u8],
    pub(super) encoding: Encoding,
    pub(super) topology: &'a Topology,
    pub(super) ingest: &'a I,
}

/// A tile value on its way into the tree.
struct TileValue<O> {
    slot: usize,
    value: O,
    active: bool,
}

impl<I> Decoder<'_, I> {
    /// Decodes the whole grid.
    pub(super) fn tree<V: Stored>(&self) -> Result<(Tree<I::Out>, I::Tally), DecodeError>
    where
        I: Ingest<V>,
    {
        let mut tally = I::Tally::default();
        let at = self.topology.background_at;
        let background: V = Cursor::new(self.bytes, at).pod("a background value")?;
        let mut stored = [self.ingest.convert(background)];
        self.ingest.inspect(None, &mut stored, &mut tally);
        let mut builder = TreeBuilder::new(stored[0]);

        for tile in self.topology.root_tiles(self.bytes, self.encoding) {
            let tile = tile?;
            let mut value = [self.ingest.convert(pod_read_unaligned(tile.value))];
            self.ingest
                .inspect(Some(tile.origin), &mut value, &mut tally);
            builder.set_root_tile(tile.origin, value[0], tile.active);
        }
        for wave in self.topology.uppers.chunks(NODES_IN_FLIGHT / 8) {
            let decoded = self.tile_values::<V>(wave, Level::Upper, background)?;
            for (node, (tiles, counts)) in wave.iter().zip(decoded) {
                self.ingest.merge(&mut tally, counts);
                let index = builder.upper_node(node.origin);
                for t in tiles {
                    builder.set_upper_tile(index, t.slot, t.value, t.active);
                }
            }
        }
        for wave in self.topology.lowers.chunks(NODES_IN_FLIGHT) {
            let decoded = self.tile_values::<V>(wave, Level::Lower, background)?;
            for (node, (tiles, counts)) in wave.iter().zip(decoded) {
                self.ingest.merge(&mut tally, counts);
                let index = builder.lower_node(node.origin);
                for t in tiles {
                    builder.set_lower_tile(index, t.slot, t.value, t.active);
                }
            }
        }
        for leaf in &self.topology.leaves {
            builder.add_brick(leaf.origin);
        }
        let (values, masks) = self.bricks::<V>(background, &mut tally)?;
        Ok((builder.finish(values, masks), tally))
    }

    /// Decodes all leaves; bricks have the order of leaves.
    fn bricks<V: Stored>(
        &self,
        background: V,
        tally: &mut I::Tally,
    ) -> Result<(Vec<I::Out>, Vec<BrickMask>), DecodeError>
    where
        I: Ingest<V>,
    {
        let leaves = &self.topology.leaves;
        let mut values = zeroed::<I::Out>(leaves.len() * BRICK_LEN)?;
        let mut masks = zeroed::<BrickMask>(leaves.len())?;
        // A small grid is cut finer, so that all threads have something to do.
        let even = leaves.len().div_ceil(4 * rayon::current_num_threads());
        let most = (SHARE_BYTES / (BRICK_LEN * size_of::<V>())).min(MAX_LEAVES);
        let share = even.clamp(most.div_ceil(8), most);
        let outcomes: Vec<_> = leaves
            .par_chunks(share)
            .zip(values.par_chunks_mut(share * BRICK_LEN))
            .zip(masks.par_chunks_mut(share))
            .map(|((leaves, values), masks)| self.share::<V>(leaves, background, values, masks))
            .collect();
        for outcome in outcomes {
            self.ingest.merge(tally, outcome?);
        }
        Ok((values, masks))
    }

    fn share<V: Stored>(
        &self,
        leaves: &[NodeAt],
        background: V,
        values: &mut [I::Out],
        masks: &mut [BrickMask],
    ) -> Result<I::Tally, DecodeError>
    where
        I: Ingest<V>,
    {
        let read = |leaf: &NodeAt| read_leaf(&mut Cursor::new(self.bytes, leaf.at), self.encoding);
        let records = leaves.iter().map(read).collect::<Result<Vec<_>, _>>()?;
        let stream = canonical::leaves(self.encoding, &records);
        let out = LeafTargets {
            records: &records,
            leaves,
            values,
            masks,
        };
        if self.encoding.half {
            self.fill(
                out,
                read_stream::<V::Half>(stream)?,
                V::from_half,
                background,
            )
        } else {
            self.fill(out, read_stream::<V>(stream)?, |v| v, background)
        }
    }

    /// Copies decoded leaves to their place and adds the inactive values.
    fn fill<V: Stored, R: Pod>(
        &self,
        out: LeafTargets<'_, '_, I::Out>,
        mut decoded: Grid<R>,
        widen: impl Fn(R) -> V,
        background: V,
    ) -> Result<I::Tally, DecodeError>
    where
        I: Ingest<V>,
    {
        let mut tally = I::Tally::default();
        let upper = decoded.tree.root_nodes.first_mut();
        let lower = upper
            .and_then(|u| u.nodes.get_mut(&0))
            .ok_or_else(|| missing("node"))?;
        let bricks = out.values.chunks_exact_mut(BRICK_LEN);
        let targets = out
            .records
            .iter()
            .zip(out.leaves)
            .zip(bricks.zip(out.masks));
        for (slot, ((record, leaf), (brick, mask))) in (0_u32..).zip(targets) {
            let buffer = lower.nodes.remove(&slot).map(|n| n.buffer);
            let buffer = buffer
                .filter(|b| b.len() == BRICK_LEN)
                .ok_or_else(|| missing("leaf"))?;
            for (to, from) in brick.iter_mut().zip(buffer) {
                *to = self.ingest.convert(widen(from));
            }
            for (to, from) in mask.iter_mut().zip(words(record.value_mask)) {
                *to = from;
            }
            self.fill_inactive(record, background, brick);
            self.ingest.inspect(Some(leaf.origin), brick, &mut tally);
        }
        Ok(tally)
    }

    /// Writes the inactive values, which canonical streams leave at zero.
    fn fill_inactive<V: Stored>(&self, record: &Record<'_>, background: V, out: &mut [I::Out])
    where
        I: Ingest<V>,
    {
        if record.dense || record.count == out.len() {
            return;
        }
        let inactive = record.inactive.map(|i| {
            self.ingest.convert(match i {
                Inactive::Background => background,
                Inactive::MinusBackground => background.negative(),
                Inactive::Value(bytes) => pod_read_unaligned(bytes),
            })
        });
        let zero = I::Out::default().bits();
        if inactive.iter().all(|v| v.bits() == zero) {
            return;
        }
        let selected = |i: usize| {
            record
                .selection
                .is_some_and(|s| s[i / 8] >> (i % 8) & 1 == 1)
        };
        for (i, value) in out.iter_mut().enumerate() {
            if record.value_mask[i / 8] >> (i % 8) & 1 == 0 {
                *value = inactive[usize::from(selected(i))];
            }
        }
    }

    /// Decodes the tile values of upper or lower nodes, leaving out inactive background.
    #[expect(
        clippy::type_complexity,
        reason = "one list and one tally a node, used once"
    )]
    fn tile_values<V: Stored>(
        &self,
        nodes: &[NodeAt],
        level: Level,
        background: V,
    ) -> Result<Vec<(Vec<TileValue<I::Out>>, I::Tally)>, DecodeError>
    where
        I: Ingest<V>,
    {
        let shares: Vec<_> = nodes
            .par_chunks(level.nodes_a_share())
            .map(|nodes| self.tile_share::<V>(nodes, level, background))
            .collect();
        let mut all = Vec::with_capacity(nodes.len());
        for share in shares {
            all.extend(share?);
        }
        Ok(all)
    }

    #[expect(
        clippy::type_complexity,
        reason = "one list and one tally a node, used once"
    )]
    fn tile_share<V: Stored>(
        &self,
        nodes: &[NodeAt],
        level: Level,
        background: V,
    ) -> Result<Vec<(Vec<TileValue<I::Out>>, I::Tally)>, DecodeError>
    where
        I: Ingest<V>,
    {
        let read = |n: &NodeAt| {
            Node::read(
                &mut Cursor::new(self.bytes, n.at),
                self.encoding,
                level.mask_len(),
            )
        };
        let parsed = nodes.iter().map(read).collect::<Result<Vec<_>, _>>()?;
        let records: Vec<_> = parsed.iter().map(|n| n.record.clone()).collect();
        let stream = match level {
            Level::Upper => canonical::uppers(self.encoding, &records),
            Level::Lower => canonical::lowers(self.encoding, &records),
        };
        let decoded: Vec<Vec<I::Out>> = if self.encoding.half {
            let convert = |h| self.ingest.convert(V::from_half(h));
            level.take_tiles(read_stream::<V::Half>(stream)?, nodes.len(), convert)?
        } else {
            let convert = |v| self.ingest.convert(v);
            level.take_tiles(read_stream::<V>(stream)?, nodes.len(), convert)?
        };
        let mut shown = [self.ingest.convert(background)];
        self.ingest
            .inspect(None, &mut shown, &mut I::Tally::default());
        let unstored = shown[0].bits();
        let tiles = nodes
            .iter()
            .zip(parsed)
            .zip(decoded)
            .map(|((at, node), mut values)| {
                self.fill_inactive(&node.record, background, &mut values);
                let mut tally = I::Tally::default();
                let mut tiles = Vec::new();
                for slot in slots_without_child(node.child_mask) {
                    let active = node.record.value_mask[slot / 8] >> (slot % 8) & 1 == 1;
                    let mut value = [values[slot]];
                    self.ingest.inspect(
                        Some(at.origin + level.slot_origin(slot)),
                        &mut value,
                        &mut tally,
                    );
                    let [value] = value;
                    if active || value.bits() != unstored {
                        tiles.push(TileValue {
                            slot,
                            value,
                            active,
                        });
                    }
                }
                (tiles, tally)
            });
        Ok(tiles.collect())
    }
}

/// Where the leaves of a share go.
struct LeafTargets<'r, 'o, O> {
    records: &'r [Record<'r>],
    leaves: &'r [NodeAt],
    values: &'o mut [O],
    masks: &'o mut [BrickMask],
}

/// The two kinds of nodes that hold tiles.
#[derive(Clone, Copy)]
enum Level {
    Upper,
    Lower,
}

impl Level {
    fn mask_len(self) -> usize {
        match self {
            Self::Upper => UPPER_MASK,
            Self::Lower => LOWER_MASK,
        }
    }

    fn nodes_a_share(self) -> usize {
        const {
            assert!(
                LOWERS_A_SHARE <= MAX_LOWERS,
                "slots of a made-up upper node"
            );
        };
        match self {
            Self::Upper => UPPERS_A_SHARE,
            Self::Lower => LOWERS_A_SHARE,
        }
    }

    fn slot_origin(self, slot: usize) -> IVec3 {
        match self {
            Self::Upper => slot_origin(slot, UPPER_LOG2, LOWER_TOTAL_LOG2),
            Self::Lower => slot_origin(slot, LOWER_LOG2, BRICK_LOG2),
        }
    }

    /// Takes the values of `count` nodes out of a decoded share.
    fn take_tiles<R: Pod, O>(
        self,
        mut decoded: Grid<R>,
        count: usize,
        convert: impl Fn(R) -> O,
    ) -> Result<Vec<Vec<O>>, DecodeError> {
        let data: Vec<_> = match self {
            Self::Upper => decoded
                .tree
                .root_nodes
                .into_iter()
                .map(|n| n.data)
                .collect(),
            Self::Lower => {
                let parent = decoded
                    .tree
                    .root_nodes
                    .first_mut()
                    .ok_or_else(|| missing("node"))?;
                let taken = (0_u32..).take(count).map(|slot| parent.nodes.remove(&slot));
                taken.flatten().map(|n| n.data).collect()
            }
        };
        let len = self.mask_len() * 8;
        if data.len() != count || data.iter().any(|d| d.len() != len) {
            return Err(missing("node"));
        }
        Ok(data
            .into_iter()
            .map(|d| d.into_iter().map(&convert).collect())
            .collect())
    }
}

/// Returns the slots that hold tiles.
fn slots_without_child(child_mask: &[u8]) -> impl Iterator<Item = usize> {
    let tiles: Vec<u8> = child_mask.iter().map(|b| !b).collect();
    // Few nodes are decoded at a time, and a node has thousands of slots.
    ones(&tiles).collect::<Vec<_>>().into_iter()
}

fn missing(what: &str) -> DecodeError {
    DecodeError::Undecodable(format!("a {what} is missing from the decoded share"))
}

/// Lets vdb-rs decode a canonical stream.
///
/// The walk has checked everything that is known to make it panic; should it panic all the
/// same, that is an error of this grid and not the end of a batch.
fn read_stream<R: Pod>(stream: Vec<u8>) -> Result<Grid<R>, DecodeError> {
    let read = || VdbReader::new(IoCursor::new(stream))?.read_grid::<R>(GRID_NAME);
    match catch_unwind(AssertUnwindSafe(read)) {
        Ok(Ok(grid)) => Ok(grid),
        Ok(Err(ParseError::IoError(e))) => Err(DecodeError::Undecodable(e.to_string())),
        Ok(Err(e)) => Err(DecodeError::Undecodable(e.to_string())),
        Err(_) => Err(DecodeError::Undecodable("the decoder panicked".to_owned())),
    }
}

/// Allocates zeros; pages are touched only when the shares write them.
fn zeroed<T: Pod>(len: usize) -> Result<Vec<T>, DecodeError> {
    bytemuck::allocation::try_zeroed_slice_box::<T>(len)
        .map(Vec::from)
        .map_err(|()| DecodeError::OutOfMemory {
            bytes: (len as u64).saturating_mul(size_of::<T>() as u64),
        })
}
