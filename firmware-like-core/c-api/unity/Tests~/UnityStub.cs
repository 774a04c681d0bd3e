// The few types of UnityEngine that PalpateTouch.cs uses, so that it compiles and runs without Unity. Values are
// kept; nothing is drawn.
using System;

namespace UnityEngine
{
    public class Component
    {
        public readonly Transform transform = new Transform();
        private readonly MeshFilter filter = new MeshFilter();

        public T GetComponent<T>() where T : class
        {
            return filter as T;
        }
    }

    public class MonoBehaviour : Component
    {
        public bool enabled = true;
    }

    public sealed class MeshFilter
    {
        public Mesh mesh;
    }

    public sealed class Transform
    {
        public Vector3 position;
        public Vector3 localPosition;

        public Vector3 InverseTransformPoint(Vector3 world)
        {
            return world;
        }
    }

    public struct Vector3
    {
        public float x, y, z;

        public Vector3(float x, float y, float z)
        {
            this.x = x;
            this.y = y;
            this.z = z;
        }

        public static Vector3 operator +(Vector3 a, Vector3 b)
        {
            return new Vector3(a.x + b.x, a.y + b.y, a.z + b.z);
        }
    }

    public sealed class Mesh
    {
        public Rendering.IndexFormat indexFormat;
        public Vector3[] vertices;
        public int[] triangles;

        public void MarkDynamic()
        {
        }

        public void RecalculateNormals()
        {
        }
    }

    public static class Application
    {
        public static string streamingAssetsPath;
    }

    public static class Debug
    {
        public static void LogException(Exception exception)
        {
            Console.Error.WriteLine(exception);
        }
    }

    [AttributeUsage(AttributeTargets.Field)]
    public sealed class TooltipAttribute : Attribute
    {
        public TooltipAttribute(string text)
        {
        }
    }

    [AttributeUsage(AttributeTargets.Class)]
    public sealed class RequireComponentAttribute : Attribute
    {
        public RequireComponentAttribute(Type type)
        {
        }
    }
}

namespace UnityEngine.Rendering
{
    public enum IndexFormat
    {
        UInt16,
        UInt32,
    }
}
