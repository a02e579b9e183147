//! The repaired stream: one share of a grid, rewritten so that vdb-rs 0.6.0 decodes it exactly.
//!
//! vdb-rs decodes zip and blosc chunks and expands active masks well, and trips over much else
//! (ADR 0005). It therefore never sees the file. It sees a small file of its own, built here
//! from records that the walk has checked:
//!
//! * one grid called `g`, offsets always present, a map it knows, no metadata but the half flag;
//! * a background of four bytes and no root tiles, as it reads those at a wrong size;
//! * record kinds 0 and 6 only: inactive values are filled in afterwards by `decode`;
//! * a chunk length of 0 where a chunk holds no values, whatever the file has there;
//! * the active-mask flag always set, with kind 6 where all values are stored.
//!
//! A share is either up to 32768 nodes' tile values or up to 4096 leaves. Its nodes hang in
//! slots 0, 1, 2 … of made-up parents: where they really belong only `decode` knows.

use super::archive::MAGIC;
use super::record::{Codec, Encoding, FLAG_ACTIVE_MASK, FLAG_BLOSC, FLAG_ZIP, Record};
use super::topology::{LEAF_MASK, LOWER_MASK, UPPER_MASK};

/// The name of the only grid in a stream.
pub(super) const GRID_NAME: &str = "g";
/// Leaves that one made-up lower node can hold.
pub(super) const MAX_LEAVES: usize = LOWER_MASK * 8;
/// Lower nodes that one made-up upper node can hold.
pub(super) const MAX_LOWERS: usize = UPPER_MASK * 8;

/// Kinds of records, see [`super::record`].
const KIND_ACTIVE_ONLY: u8 = 0;
const KIND_DENSE: u8 = 6;

/// Builds the stream of some leaves.
pub(super) fn leaves(encoding: Encoding, records: &[Record<'_>]) -> Vec<u8> {
    let payload: usize = records
        .iter()
        .map(|r| r.chunk.len() + 2 * LEAF_MASK + 16)
        .sum();
    let mut s = Stream::new(encoding, payload + 2 * (UPPER_MASK + LOWER_MASK));
    s.u32(1);
    s.root_child(1);
    s.empty_node(LOWER_MASK, records.len());
    for r in records {
        s.bytes(r.value_mask);
    }
    s.begin_buffers();
    for r in records {
        s.bytes(r.value_mask);
        s.record(r);
    }
    s.finish()
}

/// Builds the stream of some lower nodes' tile values, without their leaves.
pub(super) fn lowers(encoding: Encoding, records: &[Record<'_>]) -> Vec<u8> {
    let payload: usize = records
        .iter()
        .map(|r| r.chunk.len() + 2 * LOWER_MASK + 16)
        .sum();
    let mut s = Stream::new(encoding, payload + 2 * UPPER_MASK);
    s.u32(1);
    s.root_child(records.len());
    for r in records {
        s.childless_node(r);
    }
    s.begin_buffers();
    s.finish()
}

/// Builds the stream of some upper nodes' tile values, without their children.
pub(super) fn uppers(encoding: Encoding, records: &[Record<'_>]) -> Vec<u8> {
    let payload: usize = records
        .iter()
        .map(|r| r.chunk.len() + 2 * UPPER_MASK + 32)
        .sum();
    let mut s = Stream::new(encoding, payload);
    s.u32(u32::try_from(records.len()).expect("a share has few nodes"));
    for r in records {
        s.origin();
        s.childless_node(r);
    }
    s.begin_buffers();
    s.finish()
}

struct Stream {
    out: Vec<u8>,
    codec: Codec,
    /// Where the block and end positions stand in the descriptor.
    positions_at: usize,
}

impl Stream {
    /// Writes everything up to the number of root children.
    fn new(encoding: Encoding, payload: usize) -> Self {
        let mut s = Self {
            out: Vec::with_capacity(payload + 512),
            codec: encoding.codec,
            positions_at: 0,
        };
        s.bytes(&MAGIC.to_le_bytes());
        s.u32(224);
        s.bytes(&[0; 8]); // library version
        s.bytes(&[1]); // has grid offsets
        s.bytes(&[b'0'; 36]); // file id
        s.u32(0); // file metadata
        s.u32(1); // grids
        s.string(GRID_NAME);
        s.string("");
        s.string("");
        let grid_at = s.out.len() as u64 + 24;
        s.bytes(&grid_at.to_le_bytes());
        s.positions_at = s.out.len();
        s.bytes(&[0; 16]);

        let codec = match encoding.codec {
            Codec::Plain => 0,
            Codec::Zip => FLAG_ZIP,
            Codec::Blosc => FLAG_BLOSC,
        };
        s.u32(codec | FLAG_ACTIVE_MASK);
        s.u32(u32::from(encoding.half));
        if encoding.half {
            s.string("is_saved_as_half_float");
            s.string("bool");
            s.u32(1);
            s.bytes(&[1]);
        }
        s.string("UniformScaleMap");
        s.bytes(&[0; 15 * size_of::<f64>()]);
        s.u32(1); // buffers a leaf
        s.u32(0); // background
        s.u32(0); // root tiles
        s
    }

    fn bytes(&mut self, bytes: &[u8]) {
        self.out.extend_from_slice(bytes);
    }

    fn u32(&mut self, value: u32) {
        self.bytes(&value.to_le_bytes());
    }

    fn string(&mut self, text: &str) {
        self.u32(u32::try_from(text.len()).expect("our own strings are short"));
        self.bytes(text.as_bytes());
    }

    fn zeros(&mut self, count: usize) {
        self.out.resize(self.out.len() + count, 0);
    }

    fn origin(&mut self) {
        self.zeros(12);
    }

    /// Writes the made-up upper node of a share, with children in its first slots.
    fn root_child(&mut self, child_count: usize) {
        self.origin();
        self.empty_node(UPPER_MASK, child_count);
    }

    /// Writes a node that stores no values, with children in its first slots.
    fn empty_node(&mut self, mask_len: usize, child_count: usize) {
        let start = self.out.len();
        self.zeros(2 * mask_len);
        let full = child_count / 8;
        self.out[start..start + full].fill(0xff);
        if !child_count.is_multiple_of(8) {
            self.out[start + full] = (1 << (child_count % 8)) - 1;
        }
        self.bytes(&[KIND_ACTIVE_ONLY]);
        self.no_chunk();
    }

    /// Writes a node with its tile values and no children.
    fn childless_node(&mut self, record: &Record<'_>) {
        self.zeros(record.value_mask.len());
        self.bytes(record.value_mask);
        self.record(record);
    }

    fn record(&mut self, record: &Record<'_>) {
        let kind = if record.dense {
            KIND_DENSE
        } else {
            KIND_ACTIVE_ONLY
        };
        self.bytes(&[kind]);
        if record.count == 0 {
            self.no_chunk();
        } else {
            self.bytes(record.chunk);
        }
    }

    fn no_chunk(&mut self) {
        if self.codec != Codec::Plain {
            self.zeros(8);
        }
    }

    fn begin_buffers(&mut self) {
        let at = (self.out.len() as u64).to_le_bytes();
        self.out[self.positions_at..][..8].copy_from_slice(&at);
    }

    fn finish(mut self) -> Vec<u8> {
        let end = (self.out.len() as u64).to_le_bytes();
        self.out[self.positions_at + 8..][..8].copy_from_slice(&end);
        self.out
    }
}
