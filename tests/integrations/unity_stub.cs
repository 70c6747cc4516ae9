// The few types of UnityEngine that docs/integrations.md uses, with their mathematics, and a program that poses a body
// with a packet (file 1) on a skeleton (lines "name parent x y z" of file 2) and prints all joints, frame by frame.

using System;
using System.Collections.Generic;
using System.Globalization;
using System.IO;
using System.Linq;

namespace UnityEngine
{
    public struct Vector3
    {
        public float x, y, z;
        public Vector3(float x, float y, float z) { this.x = x; this.y = y; this.z = z; }
        public static Vector3 operator +(Vector3 a, Vector3 b) => new Vector3(a.x + b.x, a.y + b.y, a.z + b.z);
        public static Vector3 operator *(float s, Vector3 v) => new Vector3(s * v.x, s * v.y, s * v.z);
        public static Vector3 Cross(Vector3 a, Vector3 b) =>
            new Vector3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
        public static Vector3 Lerp(Vector3 a, Vector3 b, float t) => (1 - t) * a + t * b;
    }

    public struct Quaternion
    {
        public float x, y, z, w;
        public Quaternion(float x, float y, float z, float w) { this.x = x; this.y = y; this.z = z; this.w = w; }
        public static Quaternion operator *(Quaternion a, Quaternion b) => new Quaternion(
            a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y, a.w * b.y + a.y * b.w + a.z * b.x - a.x * b.z,
            a.w * b.z + a.z * b.w + a.x * b.y - a.y * b.x, a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z);
        public static Vector3 operator *(Quaternion q, Vector3 v)
        {
            var u = new Vector3(q.x, q.y, q.z);
            var t = 2 * Vector3.Cross(u, v);
            return v + q.w * t + Vector3.Cross(u, t);
        }
        public static Quaternion Slerp(Quaternion a, Quaternion b, float t)
        {
            double dot = a.x * b.x + a.y * b.y + a.z * b.z + a.w * b.w, sign = dot < 0 ? -1 : 1;
            double angle = Math.Acos(Math.Min(1, Math.Abs(dot))), sine = Math.Sin(angle);
            double p = sine < 1e-6 ? 1 - t : Math.Sin((1 - t) * angle) / sine;
            double q = sign * (sine < 1e-6 ? t : Math.Sin(t * angle) / sine);
            return new Quaternion((float)(p * a.x + q * b.x), (float)(p * a.y + q * b.y), (float)(p * a.z + q * b.z),
                                  (float)(p * a.w + q * b.w));
        }
    }

    public sealed class Transform
    {
        Transform parent;
        public Vector3 localPosition;
        public Quaternion localRotation = new Quaternion(0, 0, 0, 1);
        public void SetParent(Transform parent, bool worldPositionStays) { this.parent = parent; }
        public Quaternion rotation => parent == null ? localRotation : parent.rotation * localRotation;
        public Vector3 position => parent == null ? localPosition : parent.position + parent.rotation * localPosition;
    }

    public sealed class GameObject
    {
        public static readonly List<GameObject> All = new List<GameObject>();
        public readonly Transform transform = new Transform();
        public GameObject(string name) { All.Add(this); }
    }
}

public static class Program
{
    public static void Main(string[] files)
    {
        CultureInfo.CurrentCulture = CultureInfo.InvariantCulture;
        var packet = MovesetPacket.Read(File.ReadAllBytes(files[0]));
        var rows = File.ReadAllLines(files[1]).Select(line => line.Split(' ')).ToArray();
        var offsets = rows.Select(r => MovesetPacket.Mirror(float.Parse(r[2]), float.Parse(r[3]), float.Parse(r[4])));
        var body = new MovesetBody(new UnityEngine.Transform(), rows.Select(r => r[0]).ToArray(),
                                   rows.Select(r => int.Parse(r[1])).ToArray(), offsets.ToArray());
        Console.WriteLine($"{packet.FirstFrame} {packet.Fps} {packet.Root.Length}");
        foreach (float when in files.Skip(2).Select(float.Parse))
        {
            body.Pose(packet, (int)when, when - (int)when);
            foreach (var bone in UnityEngine.GameObject.All)
            {
                var p = bone.transform.position;
                Console.WriteLine($"{p.x:R} {p.y:R} {p.z:R}");
            }
        }
    }
}
