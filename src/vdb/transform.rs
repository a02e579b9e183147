//! Grid maps: every affine one becomes a 4×4 matrix in `f64`.
//!
//! OpenVDB multiplies row vectors from the left, `p · M`, with the translation in the last row;
//! rows of the file's matrices are therefore columns of ours. Frustum maps are walked over and
//! named, not represented: they are not affine.

use glam::{DAffine3, DMat3, DVec3};

use super::cursor::Cursor;
use super::error::Damage;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Map {
    Affine(DAffine3),
    Frustum,
    /// Of unknown length: what follows it cannot be read.
    Unknown,
}

/// Reads the map called `type_name` at the cursor.
pub(super) fn read(c: &mut Cursor<'_>, type_name: &[u8]) -> Result<Map, Damage> {
    let affine = match type_name {
        b"UniformScaleMap" | b"ScaleMap" => {
            let scale = c.dvec3("a map's scale")?;
            skip_derived(c)?;
            DAffine3::from_scale(scale)
        }
        b"TranslationMap" => DAffine3::from_translation(c.dvec3("a map's translation")?),
        b"UniformScaleTranslateMap" | b"ScaleTranslateMap" => {
            let translation = c.dvec3("a map's translation")?;
            let scale = c.dvec3("a map's scale")?;
            skip_derived(c)?;
            DAffine3::from_mat3_translation(DMat3::from_diagonal(scale), translation)
        }
        b"AffineMap" | b"UnitaryMap" => {
            let [x, y, z, w]: [[f64; 4]; 4] = c.pod("a map's matrix")?;
            let xyz = |[x, y, z, _]: [f64; 4]| DVec3::new(x, y, z);
            DAffine3::from_mat3_translation(DMat3::from_cols(xyz(x), xyz(y), xyz(z)), xyz(w))
        }
        b"NonlinearFrustumMap" => {
            // Box (2 × 3), taper, depth, then the affine map that follows the frustum.
            c.take(8 * size_of::<f64>(), "a frustum map")?;
            let second_at = c.at();
            let second = c.string("a frustum map's second map")?;
            // A frustum inside a frustum would recurse as deep as the file is long.
            if second == b"NonlinearFrustumMap" {
                return Err(Damage::new(second_at, "a frustum map inside a frustum map"));
            }
            return Ok(match read(c, second)? {
                Map::Affine(_) => Map::Frustum,
                other => other,
            });
        }
        _ => return Ok(Map::Unknown),
    };
    Ok(Map::Affine(affine))
}

/// Voxel size, inverse scale, inverse scale squared, half inverse: all follow from the scale.
fn skip_derived(c: &mut Cursor<'_>) -> Result<(), Damage> {
    c.take(4 * size_of::<DVec3>(), "a map's derived values")?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_the_file_are_images_of_the_axes() {
        // Voxels of 0.1, y up: index y goes to world z, translated by (1, 2, 3).
        let m = [
            [0.1, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.1, 0.0],
            [0.0, -0.1, 0.0, 0.0],
            [1.0, 2.0, 3.0, 1.0_f64],
        ];
        let Map::Affine(a) =
            read(&mut Cursor::new(bytemuck::cast_slice(&m), 0), b"AffineMap").unwrap()
        else {
            panic!("an affine map")
        };
        let p = a.transform_point3(DVec3::new(10.0, 20.0, 30.0));
        assert!((p - DVec3::new(2.0, -1.0, 5.0)).length() < 1e-12, "{p}");
    }

    #[test]
    fn nested_frusta_end_at_once() {
        let name = b"NonlinearFrustumMap";
        let mut b = vec![0; 64];
        b.extend(19_u32.to_le_bytes());
        b.extend(name);
        assert!(read(&mut Cursor::new(&b, 0), name).is_err(), "no recursion");
    }
}
