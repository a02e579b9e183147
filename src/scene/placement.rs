//! Where a volume stands: the map that its scene description puts after the file's own transform.
//!
//! ```text
//! world = translate · rotate z · rotate y · rotate x · scale · (what the file calls world)
//! ```

use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3};

use super::desc::{ScaleDesc, VolumeDesc};
use super::error::{Check, Source};
use super::value::finite_vector;

/// Largest entry of a map, and of its inverse.
const MAX_ENTRY: f64 = 1e30;

/// A move of a volume.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Placement {
    /// From the file's world to the scene's.
    pub(super) map: DAffine3,
    /// No length grows by more than this factor.
    pub(super) stretch: f64,
}

impl Placement {
    /// Returns the place of a volume that stands where its file says.
    pub(super) const UNMOVED: Self = Self {
        map: DAffine3::IDENTITY,
        stretch: 1.0,
    };
}

/// Returns where `volume` stands.
pub(super) fn check_placement(source: &Source, volume: &VolumeDesc) -> Check<Placement> {
    let VolumeDesc {
        translate,
        rotate,
        scale,
        matrix,
        ..
    } = volume;
    let (origin, straight) = (
        VolumeDesc::default_translate(),
        VolumeDesc::default_rotate(),
    );
    let is_moved = *translate != origin || *rotate != straight;
    let is_scaled = *scale != VolumeDesc::default_scale();
    let Some(matrix) = matrix else {
        if !is_moved && !is_scaled {
            return Ok(Placement::UNMOVED);
        }
        let size = match *scale.get_ref() {
            ScaleDesc::Uniform(s) => DVec3::splat(s),
            ScaleDesc::Axes(axes) => DVec3::from_array(axes),
        };
        // NaN is not in the range either.
        let fits = |s: f64| (MAX_ENTRY.recip()..=MAX_ENTRY).contains(&s.abs());
        if !size.to_array().into_iter().all(fits) {
            let message = format!("scale is {:?}", size.to_array());
            let expected = "numbers of 1e-30 to 1e30, or as negative to mirror";
            return Err(source.error(scale.span(), message, expected));
        }
        let [x, y, z] = finite_vector(source, "rotate", rotate)?
            .to_array()
            .map(f64::to_radians);
        let turn = DMat3::from_quat(
            DQuat::from_rotation_z(z) * DQuat::from_rotation_y(y) * DQuat::from_rotation_x(x),
        );
        let move_by = finite_vector(source, "translate", translate)?;
        let map = turn * DMat3::from_diagonal(size);
        return Ok(Placement {
            map: DAffine3::from_mat3_translation(map, move_by),
            stretch: size.abs().max_element(),
        });
    };
    if is_moved || is_scaled {
        let message = "matrix beside translate, rotate or scale";
        return Err(source.error(matrix.span(), message, "either the one or the others"));
    }
    let rows = DMat4::from_cols_array_2d(matrix.get_ref()).transpose();
    let wrong = |message: &str, expected: &str| source.error(matrix.span(), message, expected);
    if !rows.to_cols_array().iter().all(|x| x.abs() <= MAX_ENTRY) {
        return Err(wrong(
            "an entry of matrix is not finite, or huge",
            "numbers between -1e30 and 1e30",
        ));
    }
    if matrix.get_ref()[3] != [0.0, 0.0, 0.0, 1.0] {
        let expected = "0, 0, 0, 1, with the translation in the last column";
        return Err(wrong("the last row of matrix is no affine map's", expected));
    }
    let map = DAffine3::from_mat4(rows);
    let inverse = map.inverse().matrix3.to_cols_array();
    if !inverse.iter().all(|x| x.abs() <= MAX_ENTRY) {
        return Err(wrong(
            "matrix flattens the volume",
            "a matrix that can be inverted",
        ));
    }
    let DMat3 {
        x_axis,
        y_axis,
        z_axis,
    } = map.matrix3;
    let squares = x_axis.length_squared() + y_axis.length_squared() + z_axis.length_squared();
    Ok(Placement {
        map,
        // The Frobenius norm bounds the spectral one.
        stretch: squares.sqrt(),
    })
}
