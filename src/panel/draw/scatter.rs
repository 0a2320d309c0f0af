//! Accuracy against time, from a file of results.

use bevy_egui::egui::{
    Align2, Button, Color32, ComboBox, Key, Pos2, Rect, RichText, Shape, Stroke, TextEdit, Ui,
    pos2, vec2,
};

use super::{AMBER, GREY, LINE, PanelView, RED, TEXT, WEAK, dot, heading, remark, text, well};
use crate::panel::{
    axis::{Axis, number},
    data::{PanelData, PanelRequest},
    results::{Results, pareto},
};

/// units: logical px
const HEIGHT: f32 = 190.0;
/// A point is meant by a pointer that is nearer. units: logical px
const NEAR: f32 = 9.0;

/// Told apart by people who see few colours too (after Okabe and Ito 2008).
const KINDS: [Color32; 7] = [
    Color32::from_rgb(86, 180, 233),
    Color32::from_rgb(230, 159, 0),
    Color32::from_rgb(40, 190, 140),
    Color32::from_rgb(240, 228, 66),
    Color32::from_rgb(226, 110, 40),
    Color32::from_rgb(214, 136, 180),
    Color32::from_rgb(170, 176, 186),
];

pub(super) fn scatter(
    ui: &mut Ui,
    data: &PanelData,
    view: &mut PanelView,
    requests: &mut Vec<PanelRequest>,
) {
    heading(ui, "Accuracy against time", "");
    ui.horizontal(|ui| {
        let room = ui.available_width() - 56.0;
        let field = TextEdit::singleline(&mut view.path)
            .hint_text("results.jsonl, or drop it here")
            .desired_width(room);
        let entered = ui.add(field).lost_focus() && ui.input(|i| i.key_pressed(Key::Enter));
        if (ui.add(Button::new("load")).clicked() || entered) && !view.path.trim().is_empty() {
            let path = view.path.trim().into();
            requests.push(PanelRequest::Load(path));
        }
    });
    match &data.results {
        None => remark(
            ui,
            "`skyline accuracy all --out DIR` measures what every setting costs and how far off it is.",
            WEAK,
            0,
        ),
        Some((_, Err(error))) => remark(ui, &error.to_string(), RED, 0),
        Some((_, Ok(results))) => {
            if let Some(complaint) = results.complaint() {
                remark(ui, &complaint, AMBER, 0);
            }
            shown(ui, results, view);
        }
    }
}

fn shown(ui: &mut Ui, results: &Results, view: &mut PanelView) {
    // Another file may have fewer.
    if view.group >= results.groups.len() {
        view.group = 0;
        view.error = None;
    }
    let mut error = view
        .error
        .filter(|error| results.of_group(view.group, *error).next().is_some())
        .unwrap_or_else(|| results.telling_error(view.group));
    let width = ui.available_width();
    let groups = ComboBox::from_id_salt("group")
        .width(width - 8.0)
        .truncate();
    let group = |i: usize| match results.groups[i].as_str() {
        "" => "without a scene".to_owned(),
        name => name.to_owned(),
    };
    if groups
        .show_index(ui, &mut view.group, results.groups.len(), group)
        .changed()
    {
        error = results.telling_error(view.group);
        view.error = None;
    }
    ui.horizontal(|ui| {
        let errors = ComboBox::from_id_salt("error").width(200.0).truncate();
        let name = |i: usize| results.errors[i].clone();
        if errors
            .show_index(ui, &mut error, results.errors.len(), name)
            .changed()
        {
            view.error = Some(error);
        }
        ui.checkbox(&mut view.more_is_better, "more is better");
    });
    plot(ui, results, view, error);
    legend(ui, results, view.group);
}

fn plot(ui: &mut Ui, results: &Results, view: &PanelView, error: usize) {
    let (rect, response) = well(ui, HEIGHT);
    let points: Vec<(usize, f64, f64)> = results.of_group(view.group, error).collect();
    let x_axis = Axis::over(points.iter().map(|(_, ms, _)| *ms));
    let y_axis = Axis::over(points.iter().map(|(_, _, error)| *error));
    let (Some(x_axis), Some(y_axis)) = (x_axis, y_axis) else {
        let words = "No setting of this scene has this error: choose another.";
        text(ui, rect.center(), Align2::CENTER_CENTER, words, 11.5, WEAK);
        return;
    };
    let field = Rect::from_min_max(rect.min + vec2(50.0, 12.0), rect.max - vec2(14.0, 32.0));
    let x = |ms: f64| field.left() + field.width() * x_axis.place(ms);
    let y = |error: f64| field.bottom() - field.height() * y_axis.place(error);
    grid(ui, field, &x_axis, &y_axis);
    let at: Vec<Pos2> = points
        .iter()
        .map(|(_, ms, error)| pos2(x(*ms), y(*error)))
        .collect();
    let sign = if view.more_is_better { -1.0 } else { 1.0 };
    let pairs: Vec<(f64, f64)> = points.iter().map(|(_, ms, e)| (*ms, e * sign)).collect();
    let front = pareto(&pairs);
    let painter = ui.painter();
    // A step: between two settings of the front there is none better than the quicker one.
    let mut steps: Vec<Pos2> = Vec::with_capacity(2 * front.len());
    for i in &front {
        if let Some(last) = steps.last().copied() {
            steps.push(pos2(at[*i].x, last.y));
        }
        steps.push(at[*i]);
    }
    painter.add(Shape::line(
        steps,
        Stroke::new(1.0, TEXT.gamma_multiply(0.7)),
    ));
    for ((i, ..), at) in points.iter().zip(&at) {
        painter.circle_filled(*at, 3.0, colour(results.points[*i].kind));
    }
    for i in &front {
        painter.circle_stroke(at[*i], 5.0, Stroke::new(1.2, TEXT));
    }
    let pointer = response.hover_pos();
    let nearest = pointer.and_then(|pointer| {
        let distances = at.iter().map(|at| at.distance(pointer)).enumerate();
        distances
            .filter(|(_, distance)| *distance < NEAR)
            .min_by(|a, b| a.1.total_cmp(&b.1))
    });
    if let Some((nearest, _)) = nearest {
        painter.circle_stroke(at[nearest], 7.0, Stroke::new(2.0, AMBER));
        let (i, ms, value) = points[nearest];
        let is_best = front.contains(&nearest);
        response.on_hover_ui_at_pointer(|ui| {
            ui.set_max_width(320.0);
            ui.label(&results.points[i].setting);
            let mut words = format!(
                "{} ms, {} {}",
                number(ms),
                results.errors[error].replace('_', " "),
                number(value)
            );
            if is_best {
                words += "; on the Pareto front";
            }
            ui.label(RichText::new(words).color(WEAK));
        });
    }
}

fn grid(ui: &Ui, field: Rect, x_axis: &Axis, y_axis: &Axis) {
    let line = Stroke::new(1.0, LINE);
    for tick in x_axis.ticks(5) {
        let x = field.left() + field.width() * x_axis.place(tick);
        ui.painter().vline(x, field.y_range(), line);
        let at = pos2(x, field.bottom() + 3.0);
        text(ui, at, Align2::CENTER_TOP, &number(tick), 11.0, WEAK);
    }
    for tick in y_axis.ticks(5) {
        let y = field.bottom() - field.height() * y_axis.place(tick);
        ui.painter().hline(field.x_range(), y, line);
        let at = pos2(field.left() - 4.0, y);
        text(ui, at, Align2::RIGHT_CENTER, &number(tick), 11.0, WEAK);
    }
    let under = pos2(field.center().x, field.bottom() + 17.0);
    text(
        ui,
        under,
        Align2::CENTER_TOP,
        "time, ms (median)",
        11.0,
        WEAK,
    );
}

fn legend(ui: &mut Ui, results: &Results, group: usize) {
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 5.0;
        for (kind, name) in results.kinds.iter().enumerate() {
            let of_kind =
                |point: &&crate::panel::results::Point| point.group == group && point.kind == kind;
            if name.is_empty() || !results.points.iter().any(|point| of_kind(&point)) {
                continue;
            }
            dot(ui, colour(kind));
            ui.label(RichText::new(name).small().color(WEAK));
            ui.add_space(4.0);
        }
        ui.label(RichText::new("○ Pareto front").small().color(TEXT));
    });
}

fn colour(kind: usize) -> Color32 {
    KINDS.get(kind).copied().unwrap_or(GREY)
}
