//! The smallest `.vdb` file: one grid of one leaf, in memory, so that the reader can be fed with
//! values that no grid of ours would hold.

/// Returns a file with a float grid named `density` of one brick at 0, voxel size 1, all voxels
/// active; `values` are `[x][y][z]`.
pub(super) fn of_one_leaf(values: &[f32; 512]) -> Vec<u8> {
    let mut b = 0x5644_4220_u64.to_le_bytes().to_vec();
    // File version 224, library version 0, no offsets to grids, an identifier, no metadata.
    b.extend(224_u32.to_le_bytes());
    b.extend([0; 8]);
    b.push(0);
    b.extend([b'0'; 36]);
    b.extend(0_u32.to_le_bytes());
    // One grid: name, type, not an instance, three offsets that do not count.
    b.extend(1_u32.to_le_bytes());
    for word in ["density", "Tree_float_5_4_3", ""] {
        push_text(&mut b, word);
    }
    b.extend([0; 24]);
    // Active voxels' values only, not compressed; no metadata.
    b.extend(2_u32.to_le_bytes());
    b.extend(0_u32.to_le_bytes());
    // Scale, voxel size, and the three reciprocals that go with them.
    push_text(&mut b, "UniformScaleMap");
    for v in [1.0_f64, 1.0, 1.0, 0.5, 0.5]
        .map(|_| [1.0_f64; 3])
        .as_flattened()
    {
        b.extend(v.to_le_bytes());
    }
    // One buffer, background 0, no root tiles, one upper node at 0.
    b.extend(1_u32.to_le_bytes());
    b.extend(0.0_f32.to_le_bytes());
    b.extend(0_u32.to_le_bytes());
    b.extend(1_u32.to_le_bytes());
    b.extend([0; 12]);
    for slots in [32768, 4096] {
        // The child mask has its first bit set; no tile is active, and all are background.
        b.push(1);
        b.resize(b.len() + slots / 8 - 1, 0);
        b.resize(b.len() + slots / 8, 0);
        b.push(0);
    }
    // The leaf's mask with the tree, and again with its values.
    b.extend([0xff; 64]);
    b.extend([0xff; 64]);
    b.push(0);
    for v in values {
        b.extend(v.to_le_bytes());
    }
    b
}

fn push_text(out: &mut Vec<u8>, text: &str) {
    let length = u32::try_from(text.len()).expect("the words here are short");
    out.extend(length.to_le_bytes());
    out.extend(text.as_bytes());
}
