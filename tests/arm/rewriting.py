"""The same arm written down in another way."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin


def numbers(values):
    return " ".join(repr(float(value)) for value in values)


def vector(element, tag, attribute, default="0 0 0"):
    part = element.find(tag)
    return np.array([float(x) for x in (default if part is None else part.get(attribute, default)).split()])


def origin(element):
    return pin.SE3(pin.rpy.rpyToMatrix(vector(element, "origin", "rpy")), vector(element, "origin", "xyz"))


def set_origin(element, placement):
    part = element.find("origin")
    part = ET.SubElement(element, "origin") if part is None else part
    part.set("xyz", numbers(placement.translation))
    part.set("rpy", numbers(pin.rpy.matrixToRpy(placement.rotation)))


def scaled(text, factor):
    """Every length in the description times a factor."""
    root = ET.fromstring(text)
    for joint in root.findall("joint"):
        placement = origin(joint)
        placement.translation = placement.translation * factor
        set_origin(joint, placement)
        if joint.get("type") == "prismatic":
            for name in ("lower", "upper", "velocity"):
                if joint.find("limit").get(name) is not None:
                    joint.find("limit").set(name, repr(float(joint.find("limit").get(name)) * factor))
    return ET.tostring(root, encoding="unicode")


def renamed(text, rng):
    """Other names for links and joints, and another order in the text; returns new names of joints too."""
    root = ET.fromstring(text)
    new = {
        kind: {part.get("name"): f"{kind[0]}{number}" for part, number in zip(parts, order, strict=True)}
        for kind in ("link", "joint")
        for parts in [root.findall(kind)]
        for order in [rng.permutation(len(parts))]
    }
    for kind in ("link", "joint"):
        for part in root.findall(kind):
            part.set("name", new[kind][part.get("name")])
    for end in [*root.iter("parent"), *root.iter("child")]:
        end.set("link", new["link"][end.get("link")])
    parts = list(root)
    for part in parts:
        root.remove(part)
    root.extend(parts[k] for k in rng.permutation(len(parts)))
    return ET.tostring(root, encoding="unicode"), new["joint"]


def turned_frames(text, rng):
    """The frame of every joint turned at random, its axis and whatever hangs on its link turned back."""
    root = ET.fromstring(text)
    turns = {part.get("name"): np.eye(3) for part in root.findall("link")}
    for joint in root.findall("joint"):
        turns[joint.find("child").get("link")] = pin.rpy.rpyToMatrix(rng.uniform(-3, 3, 3))
    for joint in root.findall("joint"):
        before = turns[joint.find("parent").get("link")]
        after = turns[joint.find("child").get("link")]
        set_origin(joint, pin.SE3(before.T, np.zeros(3)) * origin(joint) * pin.SE3(after, np.zeros(3)))
        axis = joint.find("axis")
        if axis is not None:
            axis.set("xyz", numbers(after.T @ vector(joint, "axis", "xyz")))
    return ET.tostring(root, encoding="unicode")


def with_fixed_joints(text, rng):
    """A fixed joint and a link before every joint; together they lead where the joint alone led."""
    root = ET.fromstring(text)
    for joint in root.findall("joint"):
        name = f"extra_{joint.get('name')}"
        between = pin.SE3(pin.rpy.rpyToMatrix(rng.uniform(-3, 3, 3)), rng.uniform(-0.1, 0.1, 3))
        ET.SubElement(root, "link", name=name)
        fixed = ET.SubElement(root, "joint", name=name, type="fixed")
        ET.SubElement(fixed, "parent", link=joint.find("parent").get("link"))
        ET.SubElement(fixed, "child", link=name)
        set_origin(fixed, between)
        joint.find("parent").set("link", name)
        set_origin(joint, between.inverse() * origin(joint))
    return ET.tostring(root, encoding="unicode")


def with_sensors(text, rng):
    """One to three frames of sensors on every link, near it, some behind each other."""
    root = ET.fromstring(text)
    for link in root.findall("link"):
        parent = link.get("name")
        for k in range(rng.integers(1, 4)):
            name = f"sensor{k}_{link.get('name')}"
            ET.SubElement(root, "link", name=name)
            fixed = ET.SubElement(root, "joint", name=name, type="fixed")
            ET.SubElement(fixed, "parent", link=parent)
            ET.SubElement(fixed, "child", link=name)
            set_origin(fixed, pin.SE3(np.eye(3), rng.uniform(-1e-5, 1e-5, 3)))
            parent = name if rng.random() < 0.5 else parent
    return ET.tostring(root, encoding="unicode")
