//! All vehicles of a frame, over a finished picture.

use crate::model::{Material, Mesh, Model, ModelError, Vertex};
use crate::raster::{Canvas, Corner, Paint};
use glam::{DVec3, Mat3, Quat, Vec3};
use terravision_common::light::{Brightness, Sun};
use terravision_common::rig::View;
use terravision_common::vehicle::{IS_THERE, VehicleLook, VehicleRecord, VehiclesConfig};

/// What is this wide on the picture, pixels, has all of its triangles; what is less wide those of
/// the next level, whose cells are about a pixel, and so on.
const LEVEL_PX: [f32; 2] = [48.0, 12.0];
/// Of a vehicle that is nearer than this all that is nearer is cut off, as a share of the near
/// plane.
const CUT: f32 = 0.25;
/// A point of a side of this many pixels stands for vehicles that have none of their own.
pub const USUAL_POINT_PX: f32 = 3.0;

/// Draws vehicles. May be used by several threads.
#[derive(Debug)]
pub struct Painter {
    models: Vec<Model>,
    looks: Vec<VehicleLook>,
    brightness: Brightness,
    /// Towards the sun.
    sun: Vec3,
    near_m: f32,
}

/// How a vehicle lies before a camera.
struct Seen<'a> {
    look: &'a VehicleLook,
    /// From its axes to the camera's (right, up, ahead), with its scale.
    turn: Mat3,
    /// From its axes to the world's.
    attitude: Quat,
    /// Its origin before the camera.
    origin: Vec3,
}

/// What a camera shows, as the painter needs it.
#[derive(Clone, Copy)]
struct Lens {
    /// Pixels a metre at one metre's depth.
    focal_px: f32,
    /// Half the picture's sides, pixels, and how far right of the line of sight its middle is.
    half_px: [f32; 2],
    middle_px: f32,
    /// Lengths of the normals of its sides, for balls.
    slant: [f32; 2],
    near_m: f32,
}

/// A corner before the camera.
#[derive(Clone, Copy)]
struct Placed {
    position: Vec3,
    light: [f32; 3],
    uv: [f32; 2],
}

impl Painter {
    /// Reads the models of a run. `sun`: where the light comes from; `near_m`: the near plane that
    /// depth is told by.
    ///
    /// # Errors
    /// A model cannot be read.
    pub fn new(config: &VehiclesConfig, sun: Option<Sun>, near_m: f64) -> Result<Self, ModelError> {
        let models = config.models.iter().map(|path| Model::read(path)).collect::<Result<_, _>>()?;
        Ok(Self::of_models(models, config.vehicles.clone(), sun, near_m))
    }

    /// Likewise, of models that were read.
    #[must_use]
    pub fn of_models(models: Vec<Model>, looks: Vec<VehicleLook>, sun: Option<Sun>, near_m: f64) -> Self {
        let sun = sun.unwrap_or(Sun::AUTO);
        let direction = sun.direction().map(|v| v as f32);
        Self { models, looks, brightness: sun.brightness(), sun: Vec3::from_array(direction), near_m: near_m as f32 }
    }

    /// Draws vehicles over all views of a picture, where they are nearer than what it shows.
    /// `nearness`: the near plane over the depth along the view axis.
    pub fn draw(
        &self,
        (rgba, nearness): (&mut [u8], &mut [f32]),
        stride: usize,
        views: &[View],
        vehicles: &[VehicleRecord],
    ) {
        for view in views {
            let [at, size] = [view.at, view.size()].map(|pair| pair.map(|v| v as usize));
            let mut canvas = Canvas { rgba: &mut *rgba, nearness: &mut *nearness, stride, at, size };
            let camera = &view.camera;
            let lens = Lens::new(camera, self.near_m);
            let [right, up, ahead] = camera.axes_in_world();
            for record in vehicles.iter().filter(|record| record.flags & IS_THERE != 0) {
                let Some(look) = self.looks.get(record.vehicle as usize) else { continue };
                let from_camera = DVec3::from_array(record.position_in_world) - camera.eye();
                let origin = [right, up, ahead].map(|axis| axis.dot(from_camera) as f32);
                let attitude = Quat::from_array(record.world_from_vehicle).normalize();
                let rows = Mat3::from_cols(right.as_vec3(), up.as_vec3(), ahead.as_vec3()).transpose();
                let turn = rows * Mat3::from_quat(attitude) * look.scale;
                let seen = Seen { look, turn, attitude, origin: Vec3::from_array(origin) };
                self.vehicle(&mut canvas, &lens, &seen);
            }
        }
    }

    fn vehicle(&self, canvas: &mut Canvas<'_>, lens: &Lens, seen: &Seen<'_>) {
        let look = seen.look;
        let model = look.model.and_then(|model| self.models.get(model as usize));
        let (middle, radius) = model
            .map_or((seen.origin, 0.0), |model| (seen.origin + seen.turn * model.middle, model.radius_m * look.scale));
        let point_px = look.point_px.max(1.0);
        if !lens.may_show(middle, radius, point_px) {
            return;
        }
        let wide_px = 2.0 * radius * lens.focal_px / middle.z.max(self.near_m);
        match model.filter(|_| wide_px > point_px || middle.z < self.near_m) {
            Some(model) => {
                let wanted = LEVEL_PX.iter().take_while(|px| wide_px < **px).count();
                if let Some(mesh) = model.levels.get(wanted.min(model.levels.len().saturating_sub(1))) {
                    self.mesh(canvas, lens, seen, (model, mesh));
                }
            }
            None if middle.z >= self.near_m => {
                // As near as its nearest part: ground that is drawn in coarse facets does not hide
                // it.
                let nearest = (middle.z - radius).max(self.near_m);
                let rgb = look.rgb.map(|v| f32::from(v) / 255.0);
                canvas.point(lens.place(middle), point_px, self.near_m / nearest, rgb);
            }
            None => {}
        }
    }

    fn mesh(&self, canvas: &mut Canvas<'_>, lens: &Lens, seen: &Seen<'_>, (model, mesh): (&Model, &Mesh)) {
        let to_sun = seen.attitude.inverse() * self.sun;
        let placed = |vertex: &Vertex| {
            let toward = vertex.normal.dot(to_sun).max(0.0);
            let Brightness { ambient, direct } = self.brightness;
            Placed {
                position: seen.origin + seen.turn * vertex.position,
                light: std::array::from_fn(|channel| ambient[channel] + direct[channel] * toward),
                uv: vertex.uv,
            }
        };
        for triangle in &mesh.triangles {
            let corners = triangle.vertices.map(|vertex| placed(&mesh.vertices[vertex as usize]));
            let Some(Material { rgb, texture, is_double_sided }) = model.materials.get(triangle.material as usize)
            else {
                continue;
            };
            let texture = texture.and_then(|texture| model.textures.get(texture));
            let paint = Paint { rgb: *rgb, texture, is_double_sided: *is_double_sided };
            let near = CUT * self.near_m;
            if corners.iter().all(|corner| corner.position.z >= near) {
                canvas.triangle(&corners.map(|corner| lens.corner(&corner)), &paint);
                continue;
            }
            let (cut, count) = cut_near(&corners, near);
            for last in 2..count {
                canvas.triangle(&[0, last - 1, last].map(|index| lens.corner(&cut[index])), &paint);
            }
        }
    }
}

impl Lens {
    fn new(camera: &terravision_common::camera::Camera, near_m: f32) -> Self {
        let focal_px = camera.focal_px() as f32;
        let half_px = [camera.width(), camera.height()].map(|side| side as f32 / 2.0);
        let middle_px = camera.lens_shift_px() as f32;
        let reach = [half_px[0] + middle_px.abs(), half_px[1]];
        let slant = reach.map(|reach| (1.0 + (reach / focal_px).powi(2)).sqrt());
        Self { focal_px, half_px, middle_px, slant, near_m }
    }

    /// Whether anything of a ball may be in the picture, or of a point of that many pixels at its
    /// middle.
    fn may_show(&self, middle: Vec3, radius: f32, point_px: f32) -> bool {
        if middle.z + radius < CUT * self.near_m {
            return false;
        }
        let across = [middle.x, middle.y];
        let shift = [self.middle_px, 0.0];
        (0..2).all(|axis| {
            let tangent = |side: f32| (self.half_px[axis] + side * shift[axis] + point_px) / self.focal_px;
            let room = radius * self.slant[axis];
            across[axis] <= tangent(1.0) * middle.z + room && -across[axis] <= tangent(-1.0) * middle.z + room
        })
    }

    /// The place on the picture.
    fn place(&self, position: Vec3) -> [f32; 2] {
        let per_m = self.focal_px / position.z;
        [self.half_px[0] - self.middle_px + position.x * per_m, self.half_px[1] - position.y * per_m]
    }

    fn corner(&self, placed: &Placed) -> Corner {
        let Placed { position, light, uv } = *placed;
        Corner { place: self.place(position), nearness: self.near_m / position.z, light, uv }
    }
}

/// A triangle without what is nearer than `near`: up to four corners, and how many.
fn cut_near(corners: &[Placed; 3], near: f32) -> ([Placed; 4], usize) {
    let mut kept = [corners[0]; 4];
    let mut count = 0;
    let mut keep = |corner: Placed| {
        if let Some(place) = kept.get_mut(count) {
            *place = corner;
            count += 1;
        }
    };
    for index in 0..3 {
        let (from, to) = (corners[index], corners[(index + 1) % 3]);
        let is_before = |corner: &Placed| corner.position.z >= near;
        if is_before(&from) {
            keep(from);
        }
        if is_before(&from) != is_before(&to) {
            let share = (near - from.position.z) / (to.position.z - from.position.z);
            let mix = |a: f32, b: f32| a + (b - a) * share;
            let position = from.position.lerp(to.position, share);
            keep(Placed {
                position: Vec3::new(position.x, position.y, near),
                light: std::array::from_fn(|channel| mix(from.light[channel], to.light[channel])),
                uv: std::array::from_fn(|axis| mix(from.uv[axis], to.uv[axis])),
            });
        }
    }
    (kept, count)
}

#[cfg(test)]
mod tests;
