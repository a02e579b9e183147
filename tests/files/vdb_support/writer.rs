//! A tiny .vdb writer: a float grid with one leaf and every knob a test needs.
//!
//! Values are plain; for zip and blosc the test gives the leaf's chunk, good or bad.
//! It writes what other programs were seen to write: no grid offsets, half floats, affine maps,
//! odd names. Fields can also be set to lies.

/// What to write; start from [`Writer::default`].
#[derive(Clone, Debug)]
pub(crate) struct Writer {
    pub version: u32,
    pub offsets: bool,
    pub name: Vec<u8>,
    pub type_name: &'static str,
    pub parent: &'static str,
    /// `None`: as many as there are.
    pub grid_count: Option<u32>,
    pub metadata_count: Option<u32>,
    pub map: (&'static str, Vec<f64>),
    pub half: bool,
    pub active_mask: bool,
    /// 0 plain, 1 zip, 4 blosc.
    pub codec: u32,
    /// Replaces the leaf's values, length prefix included.
    pub chunk: Option<Vec<u8>>,
    pub background: f32,
    /// Origin, value and state of root tiles.
    pub root_tiles: Vec<([i32; 3], f32, bool)>,
    pub root_tile_count: Option<u32>,
    pub root_origins: Vec<[i32; 3]>,
    /// Value kind of the leaf's record.
    pub kind: u8,
    /// Values written in front of the chunk, as the kind asks for.
    pub inactive: Vec<f32>,
    pub leaf: [f32; 512],
    pub active: [bool; 512],
}

impl Default for Writer {
    fn default() -> Self {
        let mut w = Self {
            version: 224,
            offsets: true,
            name: b"density".to_vec(),
            type_name: "Tree_float_5_4_3",
            parent: "",
            grid_count: None,
            metadata_count: None,
            map: (
                "UniformScaleMap",
                [[0.5; 3], [0.5; 3], [2.0; 3], [4.0; 3], [1.0; 3]].concat(),
            ),
            half: false,
            active_mask: true,
            codec: 0,
            chunk: None,
            background: 0.0,
            root_tiles: Vec::new(),
            root_tile_count: None,
            root_origins: vec![[0; 3]],
            kind: 0,
            inactive: Vec::new(),
            leaf: [0.0; 512],
            active: [false; 512],
        };
        for i in [0, 9, 511] {
            w.active[i] = true;
            w.leaf[i] = 1.0 + i as f32;
        }
        w
    }
}

fn text(out: &mut Vec<u8>, bytes: &[u8]) {
    out.extend(u32::try_from(bytes.len()).expect("short").to_le_bytes());
    out.extend(bytes);
}

fn mask(bits: impl IntoIterator<Item = bool>) -> Vec<u8> {
    let bits: Vec<bool> = bits.into_iter().collect();
    bits.chunks(8)
        .map(|c| {
            c.iter()
                .enumerate()
                .fold(0, |byte, (i, &b)| byte | u8::from(b) << i)
        })
        .collect()
}

fn first_child(len: usize) -> Vec<u8> {
    mask((0..len).map(|i| i == 0))
}

impl Writer {
    /// Writes a file with this grid alone.
    pub(crate) fn file(&self) -> Vec<u8> {
        Self::file_of(std::slice::from_ref(self))
    }

    /// Writes a file of several grids; the first one's header counts.
    pub(crate) fn file_of(grids: &[Self]) -> Vec<u8> {
        let w = &grids[0];
        let mut b = 0x5644_4220_u64.to_le_bytes().to_vec();
        b.extend(w.version.to_le_bytes());
        b.extend([0; 8]);
        b.push(u8::from(w.offsets));
        b.extend([b'7'; 36]);
        b.extend(0_u32.to_le_bytes());
        let count = u32::try_from(grids.len()).expect("few");
        b.extend(w.grid_count.unwrap_or(count).to_le_bytes());
        for g in grids {
            g.grid(&mut b, w.offsets);
        }
        b
    }

    fn grid(&self, b: &mut Vec<u8>, offsets: bool) {
        text(b, &self.name);
        text(b, self.type_name.as_bytes());
        text(b, self.parent.as_bytes());
        let at = b.len();
        b.extend([0; 24]);
        b.extend(((u32::from(self.active_mask) * 2) | self.codec).to_le_bytes());
        b.extend(
            self.metadata_count
                .unwrap_or(u32::from(self.half))
                .to_le_bytes(),
        );
        if self.half {
            text(b, b"is_saved_as_half_float");
            text(b, b"bool");
            text(b, &[1]);
        }
        text(b, self.map.0.as_bytes());
        for v in &self.map.1 {
            b.extend(v.to_le_bytes());
        }
        let mut blocks = 0;
        if self.parent.is_empty() {
            self.topology(b);
            blocks = b.len();
            for _ in &self.root_origins {
                self.leaf(b);
            }
        }
        if offsets {
            let positions = [at + 24, blocks, b.len()].map(|n| (n as u64).to_le_bytes());
            b[at..at + 24].copy_from_slice(positions.as_flattened());
        }
    }

    fn topology(&self, b: &mut Vec<u8>) {
        b.extend(1_u32.to_le_bytes());
        b.extend(self.background.to_le_bytes());
        let tiles = u32::try_from(self.root_tiles.len()).expect("few");
        b.extend(self.root_tile_count.unwrap_or(tiles).to_le_bytes());
        b.extend(
            u32::try_from(self.root_origins.len())
                .expect("few")
                .to_le_bytes(),
        );
        for (origin, value, active) in &self.root_tiles {
            b.extend(origin.map(i32::to_le_bytes).as_flattened());
            b.extend(value.to_le_bytes());
            b.push(u8::from(*active));
        }
        for origin in &self.root_origins {
            b.extend(origin.map(i32::to_le_bytes).as_flattened());
            for len in [32768, 4096] {
                b.extend(first_child(len));
                b.extend(vec![0; len / 8]);
                b.push(if self.active_mask { 0 } else { 6 });
                if self.codec != 0 && !self.half {
                    b.extend([0; 8]);
                }
                if !self.active_mask {
                    b.extend(vec![0; len * if self.half { 2 } else { 4 }]);
                }
            }
            b.extend(mask(self.active));
        }
    }

    fn leaf(&self, b: &mut Vec<u8>) {
        b.extend(mask(self.active));
        b.push(self.kind);
        for v in &self.inactive {
            b.extend(v.to_le_bytes());
        }
        if (3..=5).contains(&self.kind) {
            // Every other inactive voxel is selected.
            b.extend([0b1010_1010; 64]);
        }
        if let Some(chunk) = &self.chunk {
            b.extend(chunk);
            return;
        }
        for (v, active) in self.leaf.iter().zip(self.active) {
            if active || self.kind == 6 || !self.active_mask {
                if self.half {
                    b.extend(half::f16::from_f32(*v).to_le_bytes());
                } else {
                    b.extend(v.to_le_bytes());
                }
            }
        }
    }
}
