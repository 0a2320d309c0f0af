//! The frame-time graph, its figures, and how the frame budget stands.

use bevy_egui::egui::{Align2, Color32, Rect, Shape, Stroke, Ui, pos2, vec2};

use super::{AMBER, BLUE, GREEN, LINE, RED, TEXT, WEAK, figure, heading, remark, row, text, well};
use crate::panel::{
    axis::round_up,
    data::PanelData,
    stats::{FRAMES, FrameStats},
};

/// units: logical px
const HEIGHT: f32 = 84.0;

pub(super) fn frames(ui: &mut Ui, data: &PanelData) {
    heading(ui, "Frame time", data.time_of.words());
    let target_ms = data.budget.map(|budget| budget.target_ms);
    let Some(stats) = data.frames.stats(target_ms) else {
        remark(ui, "No frame time has come yet.", AMBER, 0);
        return;
    };
    graph(ui, data, &stats, target_ms);
    figures(ui, &stats);
    if let Some(budget) = data.budget {
        let colour = match budget.is_met {
            None => AMBER,
            Some(true) => GREEN,
            Some(false) => RED,
        };
        let words = budget.words;
        let predicted = budget
            .predicted_ms
            .map_or_else(String::new, |ms| format!("; predicted {ms:.1} ms"));
        let demanded = format!("; {:.0} px² demanded", budget.demanded_px2);
        remark(
            ui,
            &format!("Budget: {words}{predicted}{demanded}"),
            colour,
            0,
        );
    }
}

/// A bar for each frame, the newest on the right.
fn graph(ui: &mut Ui, data: &PanelData, stats: &FrameStats, target_ms: Option<f32>) {
    let (rect, response) = well(ui, HEIGHT);
    let inner = rect.shrink2(vec2(4.0, 4.0));
    // One long frame does not make all others flat: it is cut, and said to be.
    let needed = stats.p99_ms.max(target_ms.unwrap_or(0.0)) * 1.2;
    let step = round_up(f64::from(needed.max(1e-3)) / 4.0) as f32;
    let top_ms = step * (needed / step).ceil().max(1.0);
    let y = |ms: f32| inner.bottom() - inner.height() * (ms / top_ms).min(1.0);
    let width = inner.width() / FRAMES as f32;
    let first = FRAMES - data.frames.len();
    let painter = ui.painter();
    let lines = (top_ms / step).round() as u32;
    for line in 1..=lines {
        let at = y(step * line as f32);
        painter.hline(
            inner.x_range(),
            at,
            Stroke::new(1.0, LINE.gamma_multiply(0.6)),
        );
    }
    for (i, ms) in data.frames.iter().enumerate() {
        let left = inner.left() + width * (first + i) as f32;
        let bar = Rect::from_min_max(pos2(left, y(ms)), pos2(left + width, inner.bottom()));
        painter.rect_filled(bar, 0, colour(ms, target_ms));
        if ms > top_ms {
            let cap = Rect::from_min_max(bar.left_top(), pos2(bar.right(), bar.top() + 3.0));
            painter.rect_filled(cap, 0, TEXT);
        }
    }
    if let Some(target_ms) = target_ms {
        let at = y(target_ms);
        painter.extend(Shape::dashed_line(
            &[pos2(inner.left(), at), pos2(inner.right(), at)],
            Stroke::new(1.0, TEXT),
            5.0,
            4.0,
        ));
        label(
            ui,
            pos2(inner.left() + 2.0, at - 1.0),
            Align2::LEFT_BOTTOM,
            &format!("target {target_ms:.1} ms"),
        );
    }
    label(
        ui,
        inner.right_top(),
        Align2::RIGHT_TOP,
        &format!("{top_ms} ms"),
    );
    let under = response.hover_pos().and_then(|at| {
        let i = ((at.x - inner.left()) / width).floor() as i64 - first as i64;
        data.frames.iter().nth(usize::try_from(i).ok()?)
    });
    if let Some(ms) = under {
        response.on_hover_text(format!("{ms:.2} ms"));
    }
}

/// Text that is readable on bars.
fn label(ui: &Ui, at: bevy_egui::egui::Pos2, align: Align2, words: &str) {
    text(ui, at + vec2(1.0, 1.0), align, words, 11.0, Color32::BLACK);
    text(ui, at, align, words, 11.0, TEXT);
}

fn colour(ms: f32, target_ms: Option<f32>) -> Color32 {
    match target_ms {
        Some(target_ms) if ms > target_ms => RED,
        Some(_) => GREEN,
        None => BLUE,
    }
}

fn figures(ui: &mut Ui, stats: &FrameStats) {
    let (names, _) = row(ui, 14.0);
    let (values, _) = row(ui, 14.0);
    let over = stats.over_budget;
    let columns = [
        ("mean", format!("{:.2} ms", stats.mean_ms), TEXT),
        ("99 %", format!("{:.2} ms", stats.p99_ms), TEXT),
        ("std", format!("{:.2} ms", stats.std_ms), TEXT),
        (
            "over target",
            over.map_or_else(
                || "no target".into(),
                |share| format!("{:.1} %", share * 100.0),
            ),
            match over {
                Some(share) if share > 0.01 => RED,
                Some(_) => GREEN,
                None => WEAK,
            },
        ),
    ];
    let width = names.width() / columns.len() as f32;
    for (i, (name, value, colour)) in columns.into_iter().enumerate() {
        let from_right = names.width() - width * (i as f32 + 1.0);
        let end = pos2(names.right() - from_right, names.center().y);
        text(ui, end, Align2::RIGHT_CENTER, name, 11.5, WEAK);
        figure(ui, values, from_right, &value, colour);
    }
}
