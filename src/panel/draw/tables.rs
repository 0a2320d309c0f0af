//! Effects, knobs, and what cameras do not show.

use bevy_egui::egui::{Align2, Slider, Stroke, Ui, pos2, vec2};

use super::{
    AMBER, BLUE, GREEN, GREY, LINE, RED, TEXT, WEAK, figure, grouped, heading, remark, row, text,
};
use crate::{
    effects::{Effect, EffectState},
    panel::{
        axis::number,
        data::{CameraRow, EffectRow, KnobRow, PanelData, PanelRequest},
    },
};

/// Where the columns of effects end, from the right: CPU, GPU, memory. units: logical px
const EFFECT_COLUMNS: [(&str, f32); 3] = [("CPU ms", 116.0), ("GPU ms", 58.0), ("MB", 0.0)];

pub(super) fn effects(ui: &mut Ui, data: &PanelData) {
    heading(ui, "Effects", "");
    if data.effects.is_empty() {
        remark(ui, "No effect is known: add SkylinePlugins.", AMBER, 0);
        return;
    }
    let (rect, _) = row(ui, 14.0);
    for (name, from_right) in EFFECT_COLUMNS {
        let at = pos2(rect.right() - from_right, rect.center().y);
        text(ui, at, Align2::RIGHT_CENTER, name, 11.5, WEAK);
    }
    for effect in &data.effects {
        effect_row(ui, effect);
    }
}

fn effect_row(ui: &mut Ui, effect: &EffectRow) {
    let (word, why, colour) = match &effect.state {
        EffectState::Unsupported(why) => ("unsupported", why.as_str(), RED),
        EffectState::Dormant => ("dormant", "nothing in the scene asks for it", GREY),
        EffectState::Idle(why) => ("idle", why.as_str(), AMBER),
        EffectState::Active(activity) => ("active", activity.what.as_str(), GREEN),
    };
    let (rect, _) = row(ui, 17.0);
    let y = rect.center().y;
    ui.painter()
        .circle_filled(pos2(rect.left() + 4.0, y), 4.0, colour);
    let at = pos2(rect.left() + 14.0, y);
    text(ui, at, Align2::LEFT_CENTER, effect.name(), 13.0, TEXT);
    let state_at = pos2(rect.left() + 146.0, y);
    text(ui, state_at, Align2::LEFT_CENTER, word, 12.0, colour);
    if let EffectState::Active(activity) = &effect.state {
        let gpu = activity
            .gpu_ms
            .map_or_else(|| "–".into(), |ms| format!("{ms:.2}"));
        let figures = [
            format!("{:.2}", activity.cpu_ms),
            gpu,
            format!("{:.1}", activity.bytes as f64 / 1e6),
        ];
        for ((_, from_right), value) in EFFECT_COLUMNS.into_iter().zip(figures) {
            figure(ui, rect, from_right, &value, TEXT);
        }
    }
    if !why.is_empty() {
        remark(ui, why, WEAK, 14);
    }
}

pub(super) fn knobs(ui: &mut Ui, data: &PanelData, requests: &mut Vec<PanelRequest>) {
    if !Effect::FrameBudget.is_built() {
        return;
    }
    heading(ui, "Knobs", "best · cheapest");
    if data.knobs.is_empty() {
        remark(
            ui,
            "Nothing in the scene has a knob that a frame budget could move.",
            WEAK,
            0,
        );
    }
    for knob in &data.knobs {
        knob_rows(ui, knob, requests);
    }
}

fn knob_rows(ui: &mut Ui, knob: &KnobRow, requests: &mut Vec<PanelRequest>) {
    let (rect, _) = row(ui, 17.0);
    let name = knob.name.replace('_', " ");
    text(
        ui,
        rect.left_center(),
        Align2::LEFT_CENTER,
        &name,
        13.0,
        TEXT,
    );
    let value = knob
        .value
        .map_or_else(|| "–".into(), |value| with_unit(value, knob.unit));
    let colour = if knob.manual.is_some() { AMBER } else { TEXT };
    figure(ui, rect, 116.0, &value, colour);
    let saving = knob
        .saves_ms
        .map_or_else(|| "saving unknown".into(), |ms| format!("saves {ms:.2} ms"));
    figure(ui, rect, 0.0, &saving, WEAK);
    let Some(last) = knob.values.len().checked_sub(1) else {
        return;
    };
    ui.push_id(knob.name, |ui| {
        ui.horizontal(|ui| {
            let ask = |step| PanelRequest::SetManual {
                knob: knob.name,
                step,
            };
            let mut by_hand = knob.manual.is_some();
            if ui.checkbox(&mut by_hand, "manual").changed() {
                requests.push(ask(by_hand.then_some(knob.at.min(last))));
            }
            let Some(step) = knob.manual else {
                way(ui, knob, last);
                return;
            };
            let mut chosen = step.min(last);
            ui.spacing_mut().slider_width = ui.available_width() - 8.0;
            let slider = Slider::new(&mut chosen, 0..=last).show_value(false);
            if ui.add(slider).changed() {
                requests.push(ask(Some(chosen)));
            }
        });
    });
}

/// The way from the best step to the cheapest, and where on it the knob stands.
fn way(ui: &mut Ui, knob: &KnobRow, last: usize) {
    let (rect, _) = row(ui, 16.0);
    let end = |value: f32| number(f64::from(value));
    let y = rect.center().y;
    let ends = [knob.values[0], knob.values[last]].map(end);
    text(
        ui,
        rect.left_center(),
        Align2::LEFT_CENTER,
        &ends[0],
        11.0,
        WEAK,
    );
    text(
        ui,
        rect.right_center(),
        Align2::RIGHT_CENTER,
        &ends[1],
        11.0,
        WEAK,
    );
    let line = rect.shrink2(vec2(44.0, 0.0));
    let x = |step: usize| line.left() + line.width() * step as f32 / last.max(1) as f32;
    let painter = ui.painter();
    painter.hline(line.x_range(), y, Stroke::new(1.0, LINE));
    // More marks than pixels would be a bar.
    if (last as f32) * 3.0 < line.width() {
        for step in 0..=last {
            painter.vline(x(step), y - 3.0..=y + 3.0, Stroke::new(1.0, LINE));
        }
    }
    let at = x(knob.at.min(last));
    painter.hline(line.left()..=at, y, Stroke::new(2.0, BLUE));
    painter.circle_filled(pos2(at, y), 4.5, BLUE);
}

fn with_unit(value: f32, unit: &str) -> String {
    let value = number(f64::from(value));
    if unit.is_empty() {
        value
    } else {
        format!("{value} {unit}")
    }
}

/// Where the columns of counts end, from the right; the last two are those of the cullings. units: logical px
const COUNT_COLUMNS: [(&str, f32); 6] = [
    ("drawn", 256.0),
    ("hidden", 206.0),
    ("layers", 156.0),
    ("frustum", 104.0),
    ("small", 56.0),
    ("occl.", 0.0),
];

/// Of these, those that are built, moved to the right.
fn count_columns() -> impl Iterator<Item = (&'static str, f32)> {
    let built = if Effect::ContributionCulling.is_built() {
        6
    } else {
        4
    };
    let (_, last) = COUNT_COLUMNS[built - 1];
    let columns = COUNT_COLUMNS.into_iter().take(built);
    columns.map(move |(name, from_right)| (name, from_right - last))
}

pub(super) fn counts(ui: &mut Ui, data: &PanelData) {
    heading(ui, "Meshes by camera", "drawn, and why not");
    if data.cameras.is_empty() {
        remark(ui, "No active camera sees meshes.", WEAK, 0);
        return;
    }
    let (rect, _) = row(ui, 14.0);
    for (name, from_right) in count_columns() {
        let at = pos2(rect.right() - from_right, rect.center().y);
        text(ui, at, Align2::RIGHT_CENTER, name, 11.5, WEAK);
    }
    for camera in &data.cameras {
        camera_rows(ui, camera);
    }
}

fn camera_rows(ui: &mut Ui, camera: &CameraRow) {
    let counts = camera.counts;
    let (rect, response) = row(ui, 17.0);
    // A long name ends where the figures begin.
    let room = pos2(rect.right() - 300.0, rect.bottom()).max(rect.left_bottom());
    let clip = bevy_egui::egui::Rect::from_min_max(rect.min, room);
    ui.painter().with_clip_rect(clip).text(
        rect.left_center(),
        Align2::LEFT_CENTER,
        &camera.name,
        bevy_egui::egui::FontId::proportional(13.0),
        TEXT,
    );
    let figures = [
        (counts.drawn, GREEN),
        (counts.hidden, TEXT),
        (counts.layers, TEXT),
        (counts.frustum, TEXT),
        (counts.contribution, AMBER),
        (counts.occluded, AMBER),
    ];
    for ((_, from_right), (count, colour)) in count_columns().zip(figures) {
        let colour = if count == 0 { GREY } else { colour };
        figure(ui, rect, from_right, &grouped(count as u64), colour);
    }
    response.on_hover_text(&camera.name);
    let mut more = format!("of {} meshes", grouped(counts.all as u64));
    if let Some((drawn, all)) = camera.triangles {
        more += &format!(
            "; {} of {} triangles in view drawn",
            grouped(drawn),
            grouped(all)
        );
    }
    if camera.drawn_late > 0 {
        more += &format!("; {} brought back", grouped(camera.drawn_late.into()));
    }
    if counts.gpu > 0 {
        more += &format!("; {} culled by the GPU", grouped(counts.gpu as u64));
    }
    remark(ui, &more, WEAK, 0);
}
