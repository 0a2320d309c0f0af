//! Groups of occludees: an entity and what hangs below it by `ChildOf` (P2, §3.1). A group found hidden or out of
//! view is not descended into.

use bevy::{
    ecs::entity::EntityHashMap,
    math::{Affine3A, Vec3A},
    prelude::*,
};

use super::{candidates::Candidate, volume::LocalBox};
use crate::occlusion::obb::aligned;

/// No group.
pub const NO_GROUP: u32 = u32::MAX;

/// One group: the occludees right below an entity, and the groups right below it.
#[derive(Clone, Debug)]
pub struct Group {
    owner: Entity,
    /// The group it is in.
    pub parent: u32,
    slots: Vec<u32>,
    groups: Vec<u32>,
    /// Encloses everything in the group, in world space; `None` where something in it has no finite bound.
    bound: Option<LocalBox>,
    /// Whether something in it changed since its bound was made. What is above a stale group is stale.
    stale: bool,
    /// Whether it stands for an entity, or waits to be used again.
    live: bool,
}

impl Group {
    /// Whether testing the group can spare a test: it has at least two members.
    pub fn spares(&self) -> bool {
        self.slots.len() + self.groups.len() > 1
    }

    /// Encloses everything in the group, in world space. Only after [`Groups::refresh`].
    pub fn bound(&self) -> Option<&LocalBox> {
        self.bound.as_ref()
    }
}

/// The forest of groups.
#[derive(Default)]
pub struct Groups {
    groups: Vec<Group>,
    of_owner: EntityHashMap<u32>,
    /// Of each slot: its group, and where it stands among the group's slots.
    of_slot: Vec<(u32, u32)>,
    any_stale: bool,
    free: Vec<u32>,
    /// Groups still to be refreshed, each after those below it.
    pending: Vec<u32>,
}

impl Groups {
    /// The group a slot is in.
    pub fn of(&self, slot: u32) -> u32 {
        self.of_slot.get(slot as usize).map_or(NO_GROUP, |of| of.0)
    }

    /// How many groups there have been at one time.
    pub fn len(&self) -> usize {
        self.groups.len()
    }

    /// A group.
    pub fn get(&self, group: u32) -> Option<&Group> {
        self.groups.get(group as usize)
    }

    /// Puts a slot below the entities `ancestors`, nearest first; below none, it is in no group.
    pub fn place(&mut self, slot: u32, ancestors: impl IntoIterator<Item = Entity>) {
        self.leave(slot);
        let mut ancestors = ancestors.into_iter();
        let Some(owner) = ancestors.next() else {
            return;
        };
        let group = self.group_of(owner);
        if self.of_slot.len() <= slot as usize {
            self.of_slot.resize(slot as usize + 1, (NO_GROUP, 0));
        }
        let slots = &mut self.groups[group as usize].slots;
        self.of_slot[slot as usize] = (group, slots.len() as u32);
        slots.push(slot);
        self.touch_group(group);
        let mut below = group;
        for owner in ancestors {
            let above = self.group_of(owner);
            self.link(below, above);
            below = above;
        }
        self.link(below, NO_GROUP);
    }

    /// Takes a slot out of its group.
    pub fn leave(&mut self, slot: u32) {
        let Some(of) = self.of_slot.get_mut(slot as usize) else {
            return;
        };
        let (group, at) = core::mem::replace(of, (NO_GROUP, 0));
        if group == NO_GROUP {
            return;
        }
        let slots = &mut self.groups[group as usize].slots;
        slots.swap_remove(at as usize);
        if let Some(moved) = slots.get(at as usize) {
            self.of_slot[*moved as usize].1 = at;
        }
        self.touch_group(group);
        self.free_if_empty(group);
    }

    /// Something in a slot changed.
    pub fn touch(&mut self, slot: u32) {
        self.touch_group(self.of(slot));
    }

    /// Brings the bounds of all groups up to date. Work is caused by change: groups in which nothing moved cost
    /// nothing.
    pub fn refresh<'a>(&mut self, occludee: impl Fn(u32) -> Option<&'a Candidate>) {
        if !core::mem::take(&mut self.any_stale) {
            return;
        }
        let mut pending = core::mem::take(&mut self.pending);
        for root in 0..self.groups.len() as u32 {
            pending.push(root);
            while let Some(group) = pending.last().copied() {
                let state = &self.groups[group as usize];
                if !state.stale || !state.live {
                    pending.pop();
                    continue;
                }
                let before = pending.len();
                let below = state.groups.iter().copied();
                pending.extend(below.filter(|g| self.groups[*g as usize].stale));
                if pending.len() == before {
                    pending.pop();
                    self.refresh_group(group, &occludee);
                }
            }
        }
        self.pending = pending;
    }

    /// Makes a group's bound from those below it, which are up to date.
    fn refresh_group<'a>(&mut self, group: u32, occludee: &impl Fn(u32) -> Option<&'a Candidate>) {
        let state = &self.groups[group as usize];
        let unbounded = (Vec3A::NAN, Vec3A::NAN);
        let of_groups = state.groups.iter().map(|child| {
            let bound = self.groups[*child as usize].bound.as_ref();
            bound.map_or(unbounded, |bound| reach_of(&Affine3A::IDENTITY, bound))
        });
        let of_slots = state.slots.iter().filter_map(|slot| {
            occludee(*slot).map(|of| reach_of(&of.world_from_local, &of.volume))
        });
        let mut reach = Some((Vec3A::INFINITY, Vec3A::NEG_INFINITY));
        for (low, high) in of_groups.chain(of_slots) {
            reach = reach
                .filter(|_| low.is_finite() && high.is_finite())
                .map(|reach| (reach.0.min(low), reach.1.max(high)));
        }
        let state = &mut self.groups[group as usize];
        state.stale = false;
        state.bound = reach
            .filter(|(low, high)| low.cmple(*high).all())
            .map(|(low, high)| aligned(low.into(), high.into()));
    }

    fn group_of(&mut self, owner: Entity) -> u32 {
        if let Some(group) = self.of_owner.get(&owner) {
            return *group;
        }
        let new = Group {
            owner,
            parent: NO_GROUP,
            slots: Vec::new(),
            groups: Vec::new(),
            bound: None,
            stale: true,
            live: true,
        };
        self.any_stale = true;
        let group = match self.free.pop() {
            Some(group) => {
                self.groups[group as usize] = new;
                group
            }
            None => {
                self.groups.push(new);
                self.groups.len() as u32 - 1
            }
        };
        self.of_owner.insert(owner, group);
        group
    }

    fn touch_group(&mut self, mut group: u32) {
        while let Some(state) = self.groups.get_mut(group as usize)
            && !state.stale
        {
            state.stale = true;
            group = state.parent;
            self.any_stale = true;
        }
    }

    /// Puts a group below another, or below none.
    fn link(&mut self, below: u32, above: u32) {
        let old = core::mem::replace(&mut self.groups[below as usize].parent, above);
        if old == above {
            // It may have become stale while what is above it was not told.
            self.touch_group(above);
            return;
        }
        if above != NO_GROUP {
            self.groups[above as usize].groups.push(below);
            self.touch_group(above);
        }
        if old != NO_GROUP {
            self.groups[old as usize].groups.retain(|g| *g != below);
            self.touch_group(old);
            self.free_if_empty(old);
        }
    }

    fn free_if_empty(&mut self, mut group: u32) {
        while let Some(state) = self.groups.get_mut(group as usize)
            && state.live
            && state.slots.is_empty()
            && state.groups.is_empty()
        {
            state.live = false;
            let parent = core::mem::replace(&mut state.parent, NO_GROUP);
            let owner = state.owner;
            if self.of_owner.get(&owner) == Some(&group) {
                self.of_owner.remove(&owner);
            }
            self.free.push(group);
            if let Some(above) = self.groups.get_mut(parent as usize) {
                above.groups.retain(|g| *g != group);
                self.touch_group(parent);
            }
            group = parent;
        }
    }
}

/// World-space reach of a box, lowest and highest corner, rounded outward.
fn reach_of(world_from_local: &Affine3A, volume: &LocalBox) -> (Vec3A, Vec3A) {
    let centre = world_from_local.transform_point3a(volume.centre.into());
    let half = volume
        .axes
        .iter()
        .map(|axis| world_from_local.transform_vector3a((*axis).into()).abs())
        .sum::<Vec3A>();
    // A dozen roundings, each of at most 2^-24 of the largest number it meets.
    let local: Vec3A = volume.centre.abs().into();
    let met = world_from_local.matrix3.x_axis.abs() * local.x
        + world_from_local.matrix3.y_axis.abs() * local.y
        + world_from_local.matrix3.z_axis.abs() * local.z
        + world_from_local.translation.abs()
        + half;
    let slack = met * (12.0 * 0.5 * f32::EPSILON);
    (centre - half - slack, centre + half + slack)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::culling::candidates::CullableBy;

    fn at(entity: Entity, x: f32) -> Candidate {
        Candidate {
            entity,
            mesh: AssetId::default(),
            world_from_local: Affine3A::from_translation(Vec3::new(x, 0.0, 0.0)),
            volume: aligned(Vec3::splat(-1.0), Vec3::splat(1.0)),
            turned: None,
            proxy: None,
            triangles: 12,
            by: CullableBy {
                occlusion: true,
                ..default()
            },
        }
    }

    fn holds(bound: &LocalBox, low: f32, high: f32) -> bool {
        let half = bound.axes[0].x;
        bound.centre.x - half <= low
            && bound.centre.x + half >= high
            && half * 2.0 < (high - low) * 1.001
    }

    #[test]
    fn a_groups_bound_follows_what_hangs_below_it() {
        let mut world = World::new();
        let e: Vec<Entity> = (0..6).map(|_| world.spawn_empty().id()).collect();
        let mut objects = [at(e[0], 0.0), at(e[1], 10.0), at(e[2], 100.0)];
        let mut groups = Groups::default();
        // root e[3] has a group e[4] with slots 0 and 1, and slot 2 itself.
        groups.place(0, [e[4], e[3]]);
        groups.place(1, [e[4], e[3]]);
        groups.place(2, [e[3]]);
        groups.refresh(|slot| objects.get(slot as usize));
        let inner = groups.of(0);
        let root = groups.of(2);
        assert_eq!(groups.of(1), inner);
        assert_eq!(groups.get(inner).unwrap().parent, root);
        assert!(groups.get(inner).unwrap().spares() && groups.get(root).unwrap().spares());
        let bound = |groups: &Groups, group| *groups.get(group).unwrap().bound().unwrap();
        assert!(holds(&bound(&groups, inner), -1.0, 11.0));
        assert!(holds(&bound(&groups, root), -1.0, 101.0));

        objects[1] = at(e[1], 20.0);
        groups.touch(1);
        groups.refresh(|slot| objects.get(slot as usize));
        assert!(holds(&bound(&groups, inner), -1.0, 21.0));

        // The inner group moves below another root; the old root keeps only slot 2.
        groups.place(0, [e[4], e[5]]);
        groups.place(1, [e[4], e[5]]);
        groups.refresh(|slot| objects.get(slot as usize));
        assert!(holds(&bound(&groups, root), 99.0, 101.0));
        assert!(!groups.get(root).unwrap().spares());

        // Without members there are no groups.
        (0..3).for_each(|slot| groups.leave(slot));
        assert!(groups.of_owner.is_empty());
    }

    #[test]
    fn a_group_that_comes_below_one_that_was_there_is_in_its_bound() {
        let mut world = World::new();
        let e: Vec<Entity> = (0..6).map(|_| world.spawn_empty().id()).collect();
        let objects = [at(e[0], 0.0), at(e[1], 10.0), at(e[2], 500.0)];
        let mut groups = Groups::default();
        groups.place(0, [e[3]]);
        groups.place(1, [e[3]]);
        groups.refresh(|slot| objects.get(slot as usize));
        groups.place(2, [e[4], e[3]]);
        groups.refresh(|slot| objects.get(slot as usize));
        let root = groups.get(groups.of(0)).and_then(Group::bound);
        assert!(holds(root.unwrap(), -1.0, 501.0));
    }

    #[test]
    fn a_model_taken_out_of_the_middle_of_a_chain_leaves_no_loop() {
        let mut world = World::new();
        let e: Vec<Entity> = (0..9).map(|_| world.spawn_empty().id()).collect();
        let [root, mid, model, x, y] = [e[0], e[1], e[2], e[3], e[4]];
        let objects: Vec<Candidate> = (0..4).map(|i| at(e[5 + i % 4], i as f32)).collect();
        let mut groups = Groups::default();
        for slot in 0..2 {
            groups.place(slot, [model, mid, root]);
        }
        groups.refresh(|slot| objects.get(slot as usize));
        for slot in 0..2 {
            groups.place(slot, [model, root]);
        }
        for slot in 2..4 {
            groups.place(slot, [x, y]);
        }
        groups.refresh(|slot| objects.get(slot as usize));
        for slot in 0..4 {
            let (mut group, mut steps) = (groups.of(slot), 0);
            while group != NO_GROUP {
                group = groups.get(group).unwrap().parent;
                steps += 1;
                assert!(steps < 5, "a loop above slot {slot}");
            }
            assert_eq!(steps, 2);
        }
        assert_eq!(groups.of_owner.len(), 4);
        assert_eq!(groups.free.len() + groups.of_owner.len(), groups.len());
    }

    #[test]
    fn a_member_without_a_finite_bound_leaves_its_groups_without_one() {
        let mut world = World::new();
        let e: Vec<Entity> = (0..4).map(|_| world.spawn_empty().id()).collect();
        let mut objects = [at(e[0], 0.0), at(e[1], f32::NAN)];
        let mut groups = Groups::default();
        groups.place(0, [e[2], e[3]]);
        groups.place(1, [e[2], e[3]]);
        groups.refresh(|slot| objects.get(slot as usize));
        let (inner, root) = (groups.of(0), groups.get(groups.of(0)).unwrap().parent);
        assert!(groups.get(inner).unwrap().bound().is_none());
        assert!(groups.get(root).unwrap().bound().is_none());
        objects[1] = at(e[1], 3.0);
        groups.touch(1);
        groups.refresh(|slot| objects.get(slot as usize));
        assert!(groups.get(root).unwrap().bound().is_some());
    }
}
